//! The frame of a page, and its small parts.

use crate::util::output::GENERATOR;
pub use crate::util::text::escape;
use std::fmt::Write;

/// The style sheet of pages and plots.
pub(super) const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// JSON for a `script` element.
pub fn json(value: &impl serde::Serialize) -> serde_json::Result<String> {
    Ok(serde_json::to_string(value)?.replace('<', "\\u003c"))
}

/// A whole page. Its policy forbids it to load anything.
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n{GENERATOR}\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
         script-src 'unsafe-inline'\">\n<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<link rel=\"icon\" href=\"data:,\">\n<title>{}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n{body}<script>\n{SCRIPT}</script>\n</body>\n</html>\n",
        escape(title)
    )
}

/// A box that scrolls sideways on its own. `label` names it for keyboard users.
pub fn scroll(label: &str, content: &str) -> String {
    format!("<div class=\"scroll\" role=\"region\" tabindex=\"0\" aria-label=\"{}\">\n{content}</div>\n", escape(label))
}

/// Shows one of several contents, chosen by name; the first one at the start. A single content is shown without a chooser.
pub fn chooser(label: &str, choices: &[(String, String)]) -> String {
    let mut out = String::from("<div class=\"choices\">\n");
    if choices.len() > 1 {
        let _ = write!(out, "<label>{} <select>", escape(label));
        for (name, _) in choices {
            let _ = write!(out, "<option>{}</option>", escape(name));
        }
        out += "</select></label>\n";
    }
    for (number, (_, content)) in choices.iter().enumerate() {
        let hidden = if number > 0 { " hidden" } else { "" };
        let _ = writeln!(out, "<div class=\"choice\"{hidden}>{content}</div>");
    }
    out + "</div>\n"
}

/// Names and values.
pub fn facts(rows: &[(String, String)]) -> String {
    let mut out = String::from("<dl class=\"facts\">\n");
    for (name, value) in rows {
        let _ = writeln!(out, "<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value));
    }
    out + "</dl>\n"
}

/// Ends the explanation of a column in which the largest value is the best one.
pub const MORE: &str = "more is better";

/// A table whose columns can be sorted; the first click on a head puts the best value first. Heads are (text, explanation); cells
/// are (sort key, HTML).
pub fn table(caption: &str, heads: &[(String, String)], rows: &[Vec<(Option<f64>, String)>]) -> String {
    let mut out = format!("<table><caption>{}</caption>\n<thead><tr>", escape(caption));
    for (text, meaning) in heads {
        let first = if meaning.ends_with(MORE) { " data-first=\"descending\"" } else { "" };
        let (meaning, text) = (escape(meaning), escape(text));
        let _ = write!(out, "<th scope=\"col\"{first}><button type=\"button\" title=\"{meaning}\">{text}</button></th>");
    }
    out += "</tr></thead>\n<tbody>\n";
    for row in rows {
        out += "<tr>";
        for (number, (value, content)) in row.iter().enumerate() {
            let value = value.map_or_else(String::new, |value| format!(" data-value=\"{value}\""));
            let _ = match number {
                0 => write!(out, "<th scope=\"row\">{content}</th>"),
                _ => write!(out, "<td{value}>{content}</td>"),
            };
        }
        out += "</tr>\n";
    }
    out += "</tbody></table>\n";
    scroll(caption, &out)
}
