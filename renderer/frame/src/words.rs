//! Turns the messages of parsers into plain words: what was found and what is needed, in at most one line.

/// Largest number of characters of a file that a message repeats.
const LONGEST: usize = 60;

/// The beginning of `text`, up to the length that a message may repeat.
pub fn shortened(text: &str) -> String {
    if text.chars().count() <= LONGEST { text.to_owned() } else { text.chars().take(LONGEST - 3).chain("...".chars()).collect() }
}

/// A text as one word of a shell, quoted only where necessary.
pub fn shell(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,:@%=".contains(c);
    if !text.is_empty() && text.chars().all(plain) { text.to_owned() } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

/// A number in the fewest digits that identify it: `1e308`, not 309 digits.
pub fn number(value: f64) -> String {
    let plain = value.to_string();
    if plain.len() <= 20 { plain } else { format!("{value:e}") }
}

/// A message of a JSON or TOML parser, without the terms of its library. A position at its end (`at line 3 column 8`) is kept.
pub fn plain(message: &str) -> String {
    let (reason, place) = match message.rfind(" at line ") {
        Some(at) if message[at..].contains(" column ") => message.split_at(at),
        _ => (message, ""),
    };
    let place = if place == " at line 0 column 0" { "" } else { place };
    format!("{}{place}", reworded(reason))
}

fn reworded(reason: &str) -> String {
    for start in ["invalid type: ", "invalid value: "] {
        if let Some((unexpected, expected)) = reason.strip_prefix(start).and_then(|rest| rest.rsplit_once(", expected ")) {
            return format!("found {} where {} is needed", found(unexpected), needed(expected));
        }
    }
    if let Some((length, expected)) = reason.strip_prefix("invalid length ").and_then(|rest| rest.split_once(", expected ")) {
        return match elements(expected) {
            Some(count) => format!("found {length} values where {count} are needed"),
            None => format!("found {length} values where {} is needed", needed(expected)),
        };
    }
    if let Some(rest) = reason.strip_prefix("unknown variant `") {
        let (name, known) = rest.rsplit_once("`, expected ").unwrap_or((rest, "another"));
        return format!("unknown name `{}`, expected {known}", shortened(name));
    }
    if let Some(rest) = reason.strip_prefix("unknown field `") {
        let (name, known) = match rest.find("`, expected ").or_else(|| rest.find("`, there are")) {
            Some(at) => rest.split_at(at),
            None => (rest, "`"),
        };
        return format!("unknown field `{}{known}", shortened(name));
    }
    if reason.starts_with("data did not match any variant of") {
        return "none of the known forms of this value".into();
    }
    if reason.starts_with("no variant of enum") {
        return "none of the keys that tell what this is".into();
    }
    let fixed = match reason {
        "EOF while parsing a value" => "the text ends where a value is needed",
        "EOF while parsing an object" => "the text ends inside an object",
        "EOF while parsing a list" => "the text ends inside a list",
        "EOF while parsing a string" => "the text ends inside a string",
        "expected value" => "no value begins here",
        "expected ident" => "a word that is none of true, false and null",
        "expected `:`" => "a colon is missing",
        "expected `,` or `]`" => "a comma or ] is missing",
        "expected `,` or `}`" => "a comma or } is missing",
        "trailing comma" => "a comma with nothing behind it",
        "trailing characters" => "more text behind the end of the value",
        "key must be a string" => "a key that is no string",
        "recursion limit exceeded" => "nested too deeply",
        "number out of range" => "a number too large",
        "invalid number" => "not a number",
        "invalid unicode code point" | "lone leading surrogate in hex escape" => "an escape that stands for no character",
        "control character (\\u0000-\\u001F) found while parsing a string" => "a control character in a string",
        other => return if other.chars().count() > 8 * LONGEST { shortened(other) } else { other.to_owned() },
    };
    fixed.into()
}

/// A description of what the file holds.
fn found(unexpected: &str) -> String {
    let quoted = |kind: &str| unexpected.strip_prefix(kind).and_then(|rest| rest.strip_prefix(" `")?.strip_suffix('`'));
    if let Some(digits) = quoted("integer").or_else(|| quoted("floating point")) {
        return if digits.len() <= 20 { digits.into() } else { digits.parse().map_or_else(|_| shortened(digits), number) };
    }
    if let Some(word) = quoted("boolean").or_else(|| quoted("character")) {
        return word.into();
    }
    if unexpected.starts_with("string ") {
        return format!("the {}", shortened(unexpected));
    }
    match unexpected {
        "map" => "an object".into(),
        "sequence" => "a list".into(),
        "null" | "unit value" | "Option value" => "null".into(),
        other => shortened(other),
    }
}

/// A description of what is needed, for the terms of the libraries.
fn needed(expected: &str) -> String {
    let whole = |low: &str, high: &str| format!("a whole number from {low} to {high}");
    let starts = |words: &[&str]| words.iter().any(|word| expected.starts_with(word));
    match expected {
        "u8" => whole("0", "255"),
        "u16" => whole("0", "65535"),
        "u32" | "index into child of root" => whole("0", "4294967295"),
        "u64" | "u128" | "usize" => "a whole number from 0 on".into(),
        "i8" | "i16" | "i32" | "i64" | "i128" | "isize" => "a whole number".into(),
        "a nonzero u32" | "a nonzero u64" | "a nonzero usize" => "a whole number from 1 on".into(),
        "f32" | "f64" => "a number".into(),
        "a boolean" | "bool" => "true or false".into(),
        "a borrowed string" | "string" | "path string" => "a string".into(),
        "unit" => "null".into(),
        "option" => "a value".into(),
        "variant identifier" | "field identifier" | "a string key" | "value" => "a name".into(),
        "a sequence" | "a tuple" => "a list".into(),
        "a map" | "map" | "string or map" => if expected == "string or map" { "a name or an object" } else { "an object" }.into(),
        _ => match elements(expected) {
            Some(count) => format!("a list of {count} values"),
            None if starts(&["struct ", "internally tagged enum ", "adjacently tagged enum ", "struct variant "]) => {
                "an object".into()
            }
            None if starts(&["enum ", "variant of enum ", "unit variant ", "newtype variant "]) => "a name or an object".into(),
            None if starts(&["tuple ", "newtype struct ", "unit struct "]) => "a value".into(),
            None => expected.into(),
        },
    }
}

/// The number of values that `expected` asks for: `an array of length 3`, `struct Size with 2 elements`, `a tuple of size 4`.
fn elements(expected: &str) -> Option<&str> {
    let count = expected
        .strip_prefix("an array of length ")
        .or_else(|| expected.strip_prefix("a tuple of size "))
        .or_else(|| expected.rsplit_once(" with ")?.1.strip_suffix(" elements"))
        .or_else(|| expected.rsplit_once(" with ")?.1.strip_suffix(" element"))?;
    (!count.is_empty() && count.bytes().all(|b| b.is_ascii_digit())).then_some(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Thing {
        size: [f32; 3],
        count: u32,
        path: Path,
        on: bool,
        name: String,
    }

    #[derive(Debug, Deserialize)]
    #[serde(tag = "type", rename_all = "snake_case")]
    #[allow(dead_code)]
    enum Path {
        Line { steps: u8 },
    }

    #[test]
    fn parsers_speak_plainly() {
        let said = |json: &str| plain(&serde_json::from_str::<Thing>(json).unwrap_err().to_string());
        let start = r#"{"size": [1, 2, 3], "#;
        for (json, expected) in [
            ("", "the text ends where a value is needed at line 1 column 0"),
            ("{", "the text ends inside an object at line 1 column 1"),
            ("[1]", "found 1 where a list of 3 values is needed at line 1 column 2"),
            ("7", "found 7 where an object is needed at line 1 column 1"),
            (r#"{"size": [1, 2]}"#, "found 2 values where 3 are needed at line 1 column 15"),
            (r#"{"size": [1, null, 3]}"#, "found null where a number is needed at line 1 column 17"),
            (r#"{"size": "big"}"#, "found the string \"big\" where a list of 3 values is needed at line 1 column 14"),
            (
                &format!("{start}\"count\": -1}}"),
                "found -1 where a whole number from 0 to 4294967295 is needed at line 1 column 31",
            ),
            (
                &format!("{start}\"count\": 3.5}}"),
                "found 3.5 where a whole number from 0 to 4294967295 is needed at line 1 column 32",
            ),
            (&format!("{start}\"path\": 3}}"), "found 3 where an object is needed at line 1 column 29"),
            (&format!("{start}\"path\": {{\"type\": \"x\"}}}}"), "unknown name `x`, expected `line` at line 1 column 4"),
            (&format!("{start}\"on\": {{}}}}"), "found an object where true or false is needed at line 1 column 26"),
            (&format!("{start}\"name\": []}}"), "found a list where a string is needed at line 1 column 28"),
            (
                &format!("{start}\"x\": 1}}"),
                "unknown field `x`, expected one of `size`, `count`, `path`, `on`, `name` at line 1 column 23",
            ),
            ("{]", "a key that is no string at line 1 column 2"),
        ] {
            // What is behind a tag is read a second time, and then the column may be one further.
            assert!(said(json).starts_with(expected), "{json}: {}", said(json));
        }
    }

    #[test]
    fn a_shell_reads_the_same_word() {
        for text in ["plain/name-1.toml", "", "two words", "it's", "$HOME;`id`", "a\nb", "*"] {
            let script = format!("printf %s {}", shell(text));
            let output = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
            assert_eq!(String::from_utf8(output.stdout).unwrap(), text, "{script}");
        }
        assert_eq!(shell("data/train"), "data/train");
    }

    #[test]
    fn messages_are_short() {
        let long = format!("{{\"size\": \"{}\"}}", "x".repeat(200_000));
        let said = plain(&serde_json::from_str::<Thing>(&long).unwrap_err().to_string());
        assert!(said.len() < 200 && said.ends_with(" column 200011"), "{said}");
        let field = format!("{{\"{}\": 1}}", "x".repeat(200_000));
        let said = plain(&serde_json::from_str::<Thing>(&field).unwrap_err().to_string());
        assert!(said.len() < 200, "{said}");
        assert_eq!(number(1e308), "1e308");
        assert_eq!(number(0.25), "0.25");
        assert_eq!(shortened("short"), "short");
    }
}
