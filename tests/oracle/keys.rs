//! A file of keys in a directory of its own, for tests of who may do what.

use std::fmt::Write;
use std::net::IpAddr;
use std::path::PathBuf;

use tempfile::TempDir;
use union3d::wire::access::keys::{Right, make};
use union3d::wire::access::{Access, Hosts};

pub(crate) struct KeyFile {
    pub(crate) path: PathBuf,
    _directory: TempDir,
}

impl KeyFile {
    /// With a key for each of these, by name; answers the keys.
    pub(crate) fn new<const N: usize>(wanted: [(&str, Right, &str); N]) -> (Self, [String; N]) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("keys.toml");
        let mut text = String::new();
        let secrets = wanted.map(|(name, right, scenes)| {
            let key = make(name, right, &[scenes.to_owned()]).unwrap();
            writeln!(text, "{}", key.line).unwrap();
            key.secret
        });
        std::fs::write(&path, text).unwrap();
        let file = Self {
            path,
            _directory: directory,
        };
        (file, secrets)
    }

    /// Who may do what by this file, on a server of loopback.
    pub(crate) fn access(&self) -> Access {
        let hosts = Hosts::new(vec![IpAddr::from([127, 0, 0, 1])], vec![], vec![]);
        Access::new(hosts, Some(&self.path)).unwrap()
    }
}
