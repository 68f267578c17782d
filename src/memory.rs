//! Memory of this process, where the system tells.

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

/// Most bytes of memory in use so far.
pub fn peak() -> u64 {
    field("VmHWM:")
}
