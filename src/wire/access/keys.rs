//! API keys: what a file says of them, and who presents one.
//!
//! A file has a line for each key. It holds the SHA-256 of the key, never the key, so that who reads the file cannot use it:
//!
//! ```toml
//! mill-3 = { sha256 = "0f3a..", rights = "write", scenes = ["part-*", "jig"] }
//! ```
//! A key is 256 bits of chance, so a plain hash of it is as hard to invert as the key is to guess; passwords would need another one.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;

use serde::Deserialize;
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;

use crate::service::SceneName;

/// What every key starts with, so that one which was published by mistake is recognised.
const PREFIX: &str = "u3d_";

/// What a line of the file is.
const FORM: &str =
    r#"NAME = { sha256 = "..", rights = "read", "write" or "admin", scenes = ["..", ..] }"#;

/// Longest name of a key, in bytes.
const NAME_BYTES_MAX: usize = 63;

/// What a key may do. Each right includes those before it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Right {
    /// Ask everything, audits included; change nothing.
    Read,
    /// Change scenes that are there: changes and dry runs of them, shapes, reverts.
    Write,
    /// Create and drop scenes.
    Admin,
}

impl Right {
    /// As a file of keys says it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Admin => "admin",
        }
    }
}

/// Scenes by their name, or by how their names begin: `jig`, `part-*`, `*`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ScenePattern {
    start: Box<str>,
    /// Whether the name may go on.
    open: bool,
}

impl ScenePattern {
    /// Reads a pattern.
    /// # Errors
    /// What is wrong with it: no scene's name, with or without a star at its end.
    pub fn new(text: &str) -> Result<Self, String> {
        let (start, open) = match text.strip_suffix('*') {
            Some(start) => (start, true),
            None => (text, false),
        };
        if !(open && start.is_empty()) {
            SceneName::new(start)
                .map_err(|_| format!("{text:?} is neither a scene's name nor the beginning of one with a star at its end"))?;
        }
        Ok(Self {
            start: start.into(),
            open,
        })
    }

    /// Whether a scene of this name is meant.
    pub fn matches(&self, scene: &str) -> bool {
        let rest = scene.strip_prefix(&*self.start);
        rest.is_some_and(|rest| self.open || rest.is_empty())
    }
}

/// Whether a text can be the name of a key: 1 to 63 letters, digits, `-` and `_`.
/// # Errors
/// What is wrong with it.
pub fn check_name(name: &str) -> Result<(), String> {
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || b"-_".contains(&byte);
    if (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(fits) {
        Ok(())
    } else {
        Err(format!(
            "{name:?} is no name of a key: 1 to {NAME_BYTES_MAX} letters, digits, - and _"
        ))
    }
}

/// A key that is known.
#[derive(PartialEq, Eq, Debug)]
pub struct Key {
    name: Box<str>,
    sha256: [u8; 32],
    right: Right,
    scenes: Box<[ScenePattern]>,
}

impl Key {
    /// Its name, which logs tell.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether it may do this to a scene.
    pub fn may(&self, right: Right, scene: &str) -> bool {
        right <= self.right && self.scenes.iter().any(|pattern| pattern.matches(scene))
    }

    /// Whether it may do this to every scene.
    pub fn may_everywhere(&self, right: Right) -> bool {
        let is_all = |pattern: &ScenePattern| pattern.open && pattern.start.is_empty();
        right <= self.right && self.scenes.iter().any(is_all)
    }
}

/// A line of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    sha256: String,
    rights: Right,
    scenes: Vec<String>,
}

/// Why a file of keys is not taken, with its place. Never shows what stands there: it may be a key.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{0}")]
pub struct InvalidKeys(String);

/// All keys of a file.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Keys(Vec<Arc<Key>>);

impl Keys {
    /// Reads a file.
    /// # Errors
    /// [`InvalidKeys`] with the line, or the name of the key, at fault.
    pub fn parse(text: &str) -> Result<Self, InvalidKeys> {
        let lines: BTreeMap<String, Line> = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| {
                let before = text.get(..span.start).unwrap_or(text);
                before.matches('\n').count() + 1
            });
            // The parser's own words repeat what stands there.
            InvalidKeys(format!(
                "line {line}: is not {FORM}, or its name stands twice"
            ))
        })?;
        let mut keys: Vec<Arc<Key>> = Vec::with_capacity(lines.len());
        for (name, line) in lines {
            let invalid = |what: String| InvalidKeys(format!("key {name:?}: {what}"));
            check_name(&name).map_err(InvalidKeys)?;
            let sha256 = digest_of_hex(&line.sha256)
                .ok_or_else(|| invalid("sha256 is not 64 hexadecimal digits".to_owned()))?;
            if let Some(other) = keys.iter().find(|other| other.sha256 == sha256) {
                return Err(invalid(format!("its sha256 is that of {:?}", other.name)));
            }
            let scenes = line.scenes.iter().map(|pattern| ScenePattern::new(pattern));
            let scenes: Box<[_]> = scenes
                .collect::<Result<_, _>>()
                .map_err(|what| invalid(format!("scenes: {what}")))?;
            if scenes.is_empty() {
                return Err(invalid("scenes is empty; \"*\" is all".to_owned()));
            }
            let right = line.rights;
            let name = name.into();
            keys.push(Arc::new(Key {
                name,
                sha256,
                right,
                scenes,
            }));
        }
        Ok(Self(keys))
    }

    /// The key that was presented, if it is one of these. Compares with all of them, in a time that does not depend on which fits.
    pub fn find(&self, presented: &str) -> Option<&Arc<Key>> {
        let digest: [u8; 32] = Sha256::digest(presented).into();
        let mut found = None;
        for key in &self.0 {
            if bool::from(key.sha256.ct_eq(&digest)) {
                found = Some(key);
            }
        }
        found
    }

    /// Whether this key is among them, with the same rights.
    pub(super) fn contain(&self, key: &Arc<Key>) -> bool {
        let mut all = self.0.iter();
        all.any(|one| Arc::ptr_eq(one, key) || one == key)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none, so that nobody may enter.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// A key that was just made.
pub struct NewKey {
    /// The key itself, which is kept nowhere else.
    pub secret: String,
    /// Its line for the file.
    pub line: String,
}

/// Makes a key from the system's source of chance.
/// # Errors
/// A name or a pattern that cannot be, or no chance to be had.
pub fn make(name: &str, right: Right, scenes: &[String]) -> Result<NewKey, String> {
    check_name(name)?;
    for pattern in scenes {
        ScenePattern::new(pattern)?;
    }
    let mut bytes = [0; 32];
    getrandom::fill(&mut bytes).map_err(|error| format!("cannot get random numbers: {error}"))?;
    let secret = format!("{PREFIX}{}", hex(&bytes));
    // Names and patterns have nothing that would need an escape.
    let scenes: Vec<_> = scenes.iter().map(|name| format!("\"{name}\"")).collect();
    let line = format!(
        "{name} = {{ sha256 = \"{}\", rights = \"{}\", scenes = [{}] }}",
        hex(&Sha256::digest(&secret)),
        right.name(),
        scenes.join(", ")
    );
    Ok(NewKey { secret, line })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").expect("a text takes what is written");
        text
    })
}

fn digest_of_hex(text: &str) -> Option<[u8; 32]> {
    let mut digest = [0; 32];
    let is_hex = text.len() == 64 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    if !is_hex {
        return None;
    }
    for (byte, digits) in digest.iter_mut().zip(text.as_bytes().chunks(2)) {
        let digits = std::str::from_utf8(digits).ok()?;
        *byte = u8::from_str_radix(digits, 16).ok()?;
    }
    Some(digest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_that_is_made_is_found_by_its_line_and_no_other_is() {
        let scenes = ["part-*".to_owned(), "jig".to_owned()];
        let [one, other] = [(); 2].map(|()| make("mill-3", Right::Write, &scenes).unwrap());
        assert_ne!(one.secret, other.secret);
        assert!(!one.line.contains(&one.secret[PREFIX.len()..]));
        let keys = Keys::parse(&one.line).unwrap();
        let key = keys.find(&one.secret).unwrap();
        assert_eq!((key.name(), key.right), ("mill-3", Right::Write));
        assert!(keys.find(&other.secret).is_none());
        assert!(keys.find("").is_none());
        assert!(Keys::default().find(&one.secret).is_none());
    }

    #[test]
    fn rights_include_those_before_them_and_scenes_are_names_or_beginnings() {
        let line = |rights: &str, scenes: &str| {
            let zeros = "0".repeat(64);
            let text =
                format!("k = {{ sha256 = \"{zeros}\", rights = \"{rights}\", scenes = {scenes} }}");
            Keys::parse(&text).unwrap().0[0].clone()
        };
        let some = line("write", "[\"part-*\", \"jig\"]");
        for (scene, known) in [
            ("part-1", true),
            ("part-", true),
            ("jig", true),
            ("jig2", false),
            ("part", false),
        ] {
            assert_eq!(some.may(Right::Read, scene), known, "{scene}");
            assert_eq!(some.may(Right::Write, scene), known, "{scene}");
            assert!(!some.may(Right::Admin, scene), "{scene}");
        }
        assert!(!some.may_everywhere(Right::Read));
        let all = line("read", "[\"*\"]");
        assert!(all.may(Right::Read, "anything") && all.may_everywhere(Right::Read));
        assert!(!all.may(Right::Write, "anything") && !all.may_everywhere(Right::Write));
    }

    /// What is wrong is told with its place, and never repeated: it may be a key that was put where its hash belongs.
    #[test]
    fn a_broken_file_is_refused_with_the_place_and_without_its_text() {
        let zeros = "0".repeat(64);
        let good = format!("a = {{ sha256 = \"{zeros}\", rights = \"read\", scenes = [\"*\"] }}\n");
        for (line, told) in [
            (
                "b = { sha256 = \"SECRET\", rights = \"read\", scenes = [\"*\"] }".to_owned(),
                "key \"b\": sha256",
            ),
            (
                "b = { key = \"SECRET\", rights = \"read\", scenes = [\"*\"] }".to_owned(),
                "line 2: ",
            ),
            ("b = \"SECRET\"".to_owned(), "line 2: "),
            ("SECRET".to_owned(), "line 2: "),
            (
                format!("b = {{ sha256 = \"{zeros}\", rights = \"read\", scenes = [\"*\"] }}"),
                "key \"b\": its sha256 is that of \"a\"",
            ),
            (
                format!(
                    "b = {{ sha256 = \"1{}\", rights = \"all\", scenes = [\"*\"] }}",
                    &zeros[1..]
                ),
                "line 2: ",
            ),
            (
                format!(
                    "b = {{ sha256 = \"1{}\", rights = \"read\", scenes = [] }}",
                    &zeros[1..]
                ),
                "key \"b\": scenes",
            ),
            (
                format!(
                    "b = {{ sha256 = \"1{}\", rights = \"read\", scenes = [\"a*b\"] }}",
                    &zeros[1..]
                ),
                "key \"b\": scenes: \"a*b\"",
            ),
            (
                format!(
                    "a = {{ sha256 = \"1{}\", rights = \"read\", scenes = [\"*\"] }}",
                    &zeros[1..]
                ),
                "line 2: ",
            ),
            (
                format!(
                    "\"b c\" = {{ sha256 = \"1{}\", rights = \"read\", scenes = [\"*\"] }}",
                    &zeros[1..]
                ),
                "\"b c\" is no name",
            ),
        ] {
            let error = Keys::parse(&format!("{good}{line}\n"))
                .unwrap_err()
                .to_string();
            assert!(error.contains(told), "{line}: {error}");
            assert!(!error.contains("SECRET"), "{error}");
        }
    }
}
