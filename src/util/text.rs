//! Text for pages and messages.

use std::fmt::Display;

/// Text for HTML and SVG, also for attributes. Control characters become spaces.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

/// A number with three digits that count, and without an exponent.
pub fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value:.0}");
    }
    let places = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.places$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A count with its noun, whose plural is regular.
pub fn plural<N: Copy + Display + PartialEq + From<u8>>(count: N, noun: &str) -> String {
    let ending = match noun.as_bytes() {
        _ if count == N::from(1) => "",
        [.., b's' | b'x'] | [.., b's' | b'c', b'h'] => "es",
        _ => "s",
    };
    format!("{count} {noun}{ending}")
}

#[cfg(test)]
mod short_tests {
    #[test]
    fn nouns_follow_their_counts() {
        let texts = [(0, "frame"), (1, "frame"), (2, "sequence"), (1, "mesh"), (3, "mesh"), (2, "process")]
            .map(|(count, noun)| super::plural(count, noun));
        assert_eq!(texts, ["0 frames", "1 frame", "2 sequences", "1 mesh", "3 meshes", "2 processes"]);
        assert_eq!((super::plural(1u64, "step"), super::plural(7usize, "step")), ("1 step".into(), "7 steps".into()));
    }

    #[test]
    fn numbers_have_no_exponents() {
        let texts = [0.0, 0.0001, 0.01251, 0.5, 2.0, 1.2345, 12.345, 1234.6, -3.5].map(super::short);
        assert_eq!(texts, ["0", "0.0001", "0.0125", "0.5", "2", "1.23", "12.3", "1235", "-3.5"]);
    }
}
