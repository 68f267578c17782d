//! The names of things in a file, for messages.

use renderflow_frame::words::shortened;

/// Most names in a message.
const MOST: usize = 12;

/// A thing by its name, or by its number, counted from 0, where it has none.
pub(crate) fn of(number: usize, name: Option<&str>) -> String {
    let printable = |name: &str| shortened(name).chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    name.filter(|name| !name.trim().is_empty()).map_or_else(|| number.to_string(), printable)
}

/// Things by name, separated by commas.
pub(crate) fn list<'a>(names: impl Iterator<Item = Option<&'a str>>) -> String {
    let all: Vec<String> = names.enumerate().map(|(number, name)| of(number, name)).collect();
    let more = if all.len() > MOST { format!(" and {} more", all.len() - MOST) } else { String::new() };
    format!("{}{more}", all[..all.len().min(MOST)].join(", "))
}
