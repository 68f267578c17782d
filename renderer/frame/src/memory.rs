//! Memory that this process may still take.

/// Bytes of main memory that are free, within the limits that the system sets for this process; `None` where the system does not
/// report it.
pub fn available() -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let free = read("/proc/meminfo").as_deref().and_then(free_of_machine)?;
    // A container or a queued job has less memory than the machine.
    let group = read("/sys/fs/cgroup/memory.max").zip(read("/sys/fs/cgroup/memory.current"));
    let group = group.and_then(|(most, used)| Some(number(&most)?.saturating_sub(number(&used)?)));
    Some(group.map_or(free, |group| group.min(free)))
}

/// Free bytes, from the text of `/proc/meminfo`.
fn free_of_machine(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    number(line.strip_suffix("kB")?).map(|kilobytes| kilobytes.saturating_mul(1024))
}

fn number(text: &str) -> Option<u64> {
    text.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_memory_is_read_from_the_system() {
        assert_eq!(free_of_machine("MemTotal:  100 kB\nMemAvailable:     20 kB\n"), Some(20 << 10));
        assert_eq!(free_of_machine("MemTotal:  100 kB\n"), None);
        assert!(!cfg!(target_os = "linux") || available().is_some_and(|bytes| bytes > 0));
    }
}
