use crate::dataset::inspect::{Inspected, inspect};
use crate::util::console;
use crate::util::text::plural;
use anyhow::{Result, anyhow, bail};
use clap::Args;
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::panic::UnwindSafe;
use std::path::{Path, PathBuf};
use std::sync::mpsc;

/// Check whether scenes, models, maps, frames, weights and datasets can be used
///
/// The command prints what is in each file, or what is wrong and where. It knows scenes, plans, transforms.json, glTF, OBJ, PLY,
/// environment maps, frames, textures, weights and dataset folders, and finds the kind by the content.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  renderflow check scene.json model.glb sky.hdr frame.0000.exr weights.safetensors data/train\n  renderflow check --json *.gltf | jq '.[] | select(.accepted | not)'\n\nExit code 0 only if every file is accepted, 130 if interrupted."
)]
pub struct Check {
    /// Files and dataset folders
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Print one JSON array
    #[arg(long)]
    json: bool,
    /// Print only the files that are refused
    #[arg(long)]
    refused: bool,
}

impl Check {
    pub fn run(self, allowed: &[PathBuf]) -> Result<()> {
        let mut refused = 0;
        let mut array = Vec::new();
        self.inspect_all(allowed, |path, inspected| {
            let accepted = inspected.verdict.is_ok();
            refused += usize::from(!accepted);
            if accepted && self.refused {
                return;
            }
            if self.json {
                array.push(object(path, inspected));
            } else {
                println!("{}", line(path, inspected));
            }
        });
        if self.json {
            println!("{}", serde_json::to_string_pretty(&array)?);
        }
        if refused > 0 {
            bail!("{refused} of {} refused", plural(self.files.len(), "file"));
        }
        Ok(())
    }

    /// Inspects several files in parallel. `tell` gets the results in the order of the files, each as soon as those before it are
    /// done. Ends early when nobody reads the output any more.
    fn inspect_all(&self, allowed: &[PathBuf], mut tell: impl FnMut(&Path, &Inspected)) {
        let (sender, receiver) = mpsc::channel();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let files = self.files.par_iter().enumerate().take_any_while(|_| !console::is_closed());
                files.for_each_with(sender, |sender, (i, path)| {
                    // The receiver is gone only when `tell` panicked.
                    let _ = sender.send((i, guarded(|| inspect(path, allowed))));
                });
            });
            let (mut early, mut next) = (BTreeMap::new(), 0);
            for (i, inspected) in receiver {
                early.insert(i, inspected);
                while let Some(inspected) = early.remove(&next) {
                    tell(&self.files[next], &inspected);
                    next += 1;
                }
            }
        });
    }
}

/// Turns a panic into a refusal, so that the other files are still inspected.
fn guarded(inspect: impl FnOnce() -> Inspected + UnwindSafe) -> Inspected {
    std::panic::catch_unwind(inspect).unwrap_or_else(|payload| {
        let reason = crate::util::panic::message(payload.as_ref());
        Inspected { kind: None, verdict: Err(anyhow!("internal error, please report it with the file: {reason}")) }
    })
}

/// The reason of a refusal on one line, without the file's own name in front.
fn reason(path: &Path, error: &anyhow::Error) -> String {
    let text = console::message(error);
    let name = path.display().to_string();
    let own = |line: &str| {
        let rest = line.strip_prefix(&name).filter(|rest| rest.starts_with([':', ' ']));
        rest.map_or(line, |rest| rest.trim_start_matches([':', ' '])).trim().to_owned()
    };
    text.lines().map(own).collect::<Vec<_>>().join("; ")
}

fn line(path: &Path, inspected: &Inspected) -> String {
    match (&inspected.verdict, inspected.kind) {
        (Ok(found), kind) => {
            let counts = found.counts.iter().map(|(name, value)| format!("{} {}", name.replace('_', " "), short(value)));
            let notes = found.notes.iter().map(|note| format!("note: {note}"));
            let parts: Vec<String> = kind.iter().map(|k| k.name().to_owned()).chain(counts).chain(notes).collect();
            format!("accepted {}: {}", path.display(), parts.join(", "))
        }
        (Err(error), Some(kind)) => format!("refused  {}: {}: {}", path.display(), kind.name(), reason(path, error)),
        (Err(error), None) => format!("refused  {}: {}", path.display(), reason(path, error)),
    }
}

/// A value for people: sizes as 4 x 3, long numbers rounded.
fn short(value: &Value) -> String {
    match value {
        Value::Array(items) if items.len() == 2 => items.iter().map(short).collect::<Vec<_>>().join(" x "),
        Value::Array(items) => format!("({})", items.iter().map(short).collect::<Vec<_>>().join(" ")),
        Value::String(text) => text.clone(),
        Value::Null => "none".into(),
        Value::Bool(yes) => if *yes { "yes" } else { "no" }.into(),
        Value::Number(number) if number.is_f64() => {
            let v = number.as_f64().unwrap_or_default();
            // Four digits, plain where that is short.
            let plain = v == 0.0 || (1e-3..1e6).contains(&v.abs());
            if plain { format!("{}", (v * 1e4).round() / 1e4) } else { format!("{v:.3e}") }
        }
        other => other.to_string(),
    }
}

fn object(path: &Path, inspected: &Inspected) -> Value {
    let mut object = Map::new();
    object.insert("path".into(), json!(path.to_string_lossy()));
    object.insert("accepted".into(), json!(inspected.verdict.is_ok()));
    object.insert("kind".into(), json!(inspected.kind));
    match &inspected.verdict {
        Ok(found) => {
            let counts: Map<String, Value> =
                found.counts.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
            object.insert("counts".into(), counts.into());
            object.insert("notes".into(), json!(found.notes));
        }
        Err(error) => {
            object.insert("reason".into(), json!(reason(path, error)));
        }
    }
    object.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_fit_on_a_line_and_do_not_repeat_the_name() {
        let path = Path::new("a/b.json");
        let error = anyhow!("a/b.json /frames: 0 is too few\na/b.json /name: empty");
        assert_eq!(reason(path, &error), "/frames: 0 is too few; /name: empty");
        assert_eq!(reason(path, &anyhow!("a/b.json.bak: no")), "a/b.json.bak: no");
    }

    #[test]
    fn a_panic_is_a_refusal() {
        let inspected = guarded(|| panic!("on purpose: {}", 7));
        let text = line(Path::new("x"), &inspected);
        assert!(text.starts_with("refused  x: internal error") && text.contains("on purpose: 7"), "{text}");
    }

    #[test]
    fn numbers_for_people() {
        assert_eq!(short(&json!([64, 32])), "64 x 32");
        assert_eq!(short(&json!(1.234_567_8)), "1.2346");
        assert_eq!(short(&json!(2.5e30)), "2.500e30");
        assert_eq!(short(&json!(null)), "none");
    }
}
