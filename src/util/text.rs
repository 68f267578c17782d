//! Text for pages.

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

#[cfg(test)]
mod short_tests {
    #[test]
    fn numbers_have_no_exponents() {
        let texts = [0.0, 0.0001, 0.01251, 0.5, 2.0, 1.2345, 12.345, 1234.6, -3.5].map(super::short);
        assert_eq!(texts, ["0", "0.0001", "0.0125", "0.5", "2", "1.23", "12.3", "1235", "-3.5"]);
    }
}
