//! What the machine gives: room on the disk, and memory.

use std::fs;
use std::io;
use std::path::Path;

/// The disk that a directory is on.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Disk {
    /// Its size, in bytes.
    pub size_bytes: u64,
    /// What a user who is not root can still write, in bytes.
    pub free_bytes: u64,
}

/// The disk that a directory is on. May block while the file system does not answer.
/// # Errors
/// The file system's.
pub(super) fn disk(directory: &Path) -> io::Result<Disk> {
    let found = rustix::fs::statvfs(directory)?;
    Ok(Disk {
        size_bytes: found.f_blocks * found.f_frsize,
        free_bytes: found.f_bavail * found.f_frsize,
    })
}

/// Memory that this process may take, in bytes: that of the machine, or of a control group (version 2) that it is in, whichever is
/// least. None where neither can be asked.
pub fn memory_limit_bytes() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup")
        .ok()
        .and_then(|own| control_group_limit(Path::new("/sys/fs/cgroup"), &own));
    [machine_memory_bytes(), groups].into_iter().flatten().min()
}

#[cfg(target_os = "linux")]
#[expect(clippy::unnecessary_wraps, reason = "elsewhere there is nobody to ask")]
fn machine_memory_bytes() -> Option<u64> {
    // Not from /proc/meminfo, which a sandbox may hide.
    let machine = rustix::system::sysinfo();
    Some(machine.totalram * u64::from(machine.mem_unit))
}

#[cfg(not(target_os = "linux"))]
fn machine_memory_bytes() -> Option<u64> {
    None
}

/// The least limit of the groups that `own`, the text of `/proc/self/cgroup`, names, and of those above it under `root`.
fn control_group_limit(root: &Path, own: &str) -> Option<u64> {
    let own = own.lines().find_map(|line| line.strip_prefix("0::/"))?;
    let limit = |group: &Path| {
        let text = fs::read_to_string(root.join(group).join("memory.max")).ok()?;
        // "max" is no limit.
        text.trim().parse::<u64>().ok()
    };
    Path::new(own).ancestors().filter_map(limit).min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_has_less_free_than_there_is() {
        let directory = tempfile::tempdir().unwrap();
        let found = disk(directory.path()).unwrap();
        assert!(0 < found.free_bytes && found.free_bytes <= found.size_bytes);
        assert!(disk(&directory.path().join("nothing")).is_err());
    }

    /// The least limit on the way up holds; groups without one, and files that say something else, are passed over.
    #[test]
    fn the_least_limit_of_the_control_groups_holds() {
        let root = tempfile::tempdir().unwrap();
        let write = |group: &str, text: &str| {
            let group = root.path().join(group);
            fs::create_dir_all(&group).unwrap();
            fs::write(group.join("memory.max"), text).unwrap();
        };
        write("a/b", "max\n");
        write("a", "5000000000\n");
        let limit = |own: &str| control_group_limit(root.path(), own);
        assert_eq!(limit("0::/a/b\n"), Some(5_000_000_000));
        write("a/b", "3000000000\n");
        assert_eq!(limit("0::/a/b\n"), Some(3_000_000_000));
        assert_eq!(limit("0::/a\n"), Some(5_000_000_000));
        assert_eq!(limit("0::/\n"), None);
        write("", "7000\n");
        assert_eq!(limit("0::/\n"), Some(7000));
        assert_eq!(limit("4:memory:/a\n"), None, "version 1");
        assert!(memory_limit_bytes().is_some_and(|bytes| bytes > 1 << 20));
    }
}
