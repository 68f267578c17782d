//! The memory and disk of the machine, the memory and libraries of this process, and the name of the processor, as far as the
//! system reports them.

use anyhow::{Result, bail};
use std::path::Path;

/// A field of `/proc/self/status` in bytes; 0 where there is none.
fn field(name: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kilobytes =
        status.lines().find_map(|l| l.strip_prefix(name)).and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}

/// Bytes of memory in use now.
pub fn resident() -> u64 {
    field("VmRSS:")
}

/// The most bytes of memory in use so far.
pub fn peak() -> u64 {
    field("VmHWM:")
}

/// Name of the processor.
pub fn processor() -> String {
    let about = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = about.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

/// Bytes that are free for this user on the disk of a folder.
#[cfg(unix)]
pub fn free_disk(folder: &Path) -> Option<u64> {
    rustix::fs::statvfs(folder).ok().map(|disk| disk.f_bavail * disk.f_frsize)
}

/// Bytes that are free for this user on the disk of a folder; here the system does not tell.
#[cfg(not(unix))]
pub fn free_disk(_: &Path) -> Option<u64> {
    None
}

/// Bytes of memory that this process may still take. It is the smallest of three numbers: what the machine has left, what the
/// control groups of the process allow (containers, batch systems), and what the limit of its address space leaves. `None` where
/// the system reports nothing.
pub fn available() -> Option<u64> {
    available_by(Path::new("/proc"), Path::new("/sys/fs/cgroup"))
}

/// Refuses work that needs more memory than is available: `needed` bytes for `what`. `way_out` says how to need less.
///
/// # Errors
/// When less memory is available; the message has both numbers. Where the system reports nothing, nothing is refused.
pub fn ensure_memory(what: &str, needed: u64, way_out: &str) -> Result<()> {
    match available() {
        Some(available) if needed > available => {
            bail!("{what} takes about {} of memory, but {} are available: {way_out}", gigabytes(needed), gigabytes(available))
        }
        _ => Ok(()),
    }
}

/// A size for people.
pub fn gigabytes(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30))
}

/// As [`available`], with other folders in place of the system's.
fn available_by(proc: &Path, groups: &Path) -> Option<u64> {
    let read = |path: &Path| std::fs::read_to_string(path).ok();
    let meminfo = read(&proc.join("meminfo")).and_then(|text| kilobytes(&text, "MemAvailable:"));
    let own = read(&proc.join("self/cgroup")).unwrap_or_default();
    let in_groups = own.lines().filter_map(|line| {
        let mut fields = line.splitn(3, ':').skip(1);
        let (controllers, path) = (fields.next()?, fields.next()?.trim_start_matches('/'));
        match controllers {
            "" => Some((groups.to_owned(), path, ["memory.max", "memory.current"])),
            _ if controllers.split(',').any(|c| c == "memory") => {
                Some((groups.join("memory"), path, ["memory.limit_in_bytes", "memory.usage_in_bytes"]))
            }
            _ => None,
        }
    });
    // A group may hold no more than the groups around it. In a container, the outermost group that it sees is its own.
    let in_groups = in_groups.flat_map(|(root, path, [limit, usage])| {
        let folder = root.join(path);
        let folders: Vec<_> = folder.ancestors().take_while(|folder| folder.starts_with(&root)).map(Path::to_owned).collect();
        folders.into_iter().filter_map(move |folder| {
            let number = |name: &str| read(&folder.join(name))?.trim().parse::<u64>().ok();
            let stat = read(&folder.join("memory.stat")).unwrap_or_default();
            // The system frees cached files when memory is short.
            let files = bytes(&stat, "inactive_file ").unwrap_or(0) + bytes(&stat, "active_file ").unwrap_or(0);
            Some(number(limit)?.saturating_sub(number(usage)?.saturating_sub(files)))
        })
    });
    let limits = read(&proc.join("self/limits")).unwrap_or_default();
    let space =
        limits.lines().find_map(|line| line.strip_prefix("Max address space")?.split_whitespace().next()?.parse::<u64>().ok());
    let taken = read(&proc.join("self/status")).and_then(|text| kilobytes(&text, "VmSize:"));
    let space = space.map(|space| space.saturating_sub(taken.unwrap_or(0)));
    meminfo.into_iter().chain(in_groups).chain(space).min()
}

/// The number after `name` at the start of a line.
fn bytes(text: &str, name: &str) -> Option<u64> {
    text.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next()?.parse().ok())
}

/// As [`bytes`], for a number of kilobytes.
fn kilobytes(text: &str, name: &str) -> Option<u64> {
    bytes(text, name).map(|number| number.saturating_mul(1024))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Folders that look like the system's.
    struct System(tempfile::TempDir);

    impl System {
        fn new(files: &[(&str, &str)]) -> Self {
            let folder = tempfile::tempdir().expect("a folder");
            for (name, text) in files {
                let path = folder.path().join(name);
                std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
                std::fs::write(path, text).expect("a file");
            }
            Self(folder)
        }

        fn available(&self) -> Option<u64> {
            let [proc, groups]: [std::path::PathBuf; 2] = ["proc", "groups"].map(|name| self.0.path().join(name));
            available_by(&proc, &groups)
        }
    }

    const MEMINFO: (&str, &str) = ("proc/meminfo", "MemTotal:       9000 kB\nMemAvailable:   8000 kB\n");

    #[test]
    fn the_least_of_all_limits_counts() {
        assert_eq!(System::new(&[]).available(), None);
        assert_eq!(System::new(&[MEMINFO]).available(), Some(8000 << 10));
        // Version 2: the group around allows less; files in memory are not counted.
        let second = [
            MEMINFO,
            ("proc/self/cgroup", "0::/slice/job\n"),
            ("groups/slice/job/memory.max", "max\n"),
            ("groups/slice/job/memory.current", "100\n"),
            ("groups/slice/memory.max", "5000000\n"),
            ("groups/slice/memory.current", "3000000\n"),
            ("groups/slice/memory.stat", "anon 1\ninactive_file 400000\nactive_file 600000\n"),
        ];
        assert_eq!(System::new(&second).available(), Some(3_000_000));
        // Version 1, in a container: the path is not seen inside.
        let first = [
            MEMINFO,
            ("proc/self/cgroup", "5:cpu,cpuacct:/x\n4:memory:/docker/abc\n0::/\n"),
            ("groups/memory/memory.limit_in_bytes", "2000000\n"),
            ("groups/memory/memory.usage_in_bytes", "500000\n"),
        ];
        assert_eq!(System::new(&first).available(), Some(1_500_000));
        let unlimited = ("proc/self/limits", "Limit  Soft\nMax address space         unlimited  unlimited bytes\n");
        assert_eq!(System::new(&[MEMINFO, unlimited]).available(), Some(8000 << 10));
        let limits = ("proc/self/limits", "Limit  Soft\nMax address space         4000000  unlimited bytes\n");
        let status = ("proc/self/status", "VmPeak: 9 kB\nVmSize:  1000 kB\n");
        assert_eq!(System::new(&[MEMINFO, limits, status]).available(), Some(4_000_000 - 1_024_000));
    }

    #[test]
    fn refusals_have_numbers_and_a_way_out() {
        let error = ensure_memory("a picture of 9 x 9", u64::MAX / 2, "ask for less").unwrap_err().to_string();
        assert!(error.contains("about 8589934592.0 GiB of memory") && error.ends_with("ask for less"), "{error}");
        assert!(ensure_memory("nothing", 0, "").is_ok());
    }
}
