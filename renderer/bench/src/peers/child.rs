//! Another renderer in a process of its own, which lives as long as the measurement and renders on command.
//!
//! Both sides speak JSON, one object a line. The script says `{"ready": {"name", "version"}}` or `{"unavailable": REASON}` first,
//! then answers every command with an object of its own, `{"error": REASON}` where it failed:
//!
//! | command | answer |
//! |---|---|
//! | `{"load": PATH OF scene.json}` | `{"loaded": true, "notes": [...]}` |
//! | `{"warm": {"spps": [...]}}`: compile and allocate whatever those renders need | `{"warm": true}` |
//! | `{"render": {"spp", "seed", "file"}}`: write height x width x 3 little-endian floats | `{"wall": SECONDS, "cpu": SECONDS}` of rendering alone |
//!
//! It ends when its standard input does.

use anyhow::{Context, Result, anyhow, bail};
use renderflow::util::cancel::Interrupted;
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// Longest silence of a script that is not taken for its end.
const PATIENCE: Duration = Duration::from_secs(3600);

/// A running script.
pub struct Child {
    process: std::process::Child,
    commands: ChildStdin,
    answers: Receiver<String>,
    /// As in `3.9.1`.
    pub version: String,
}

/// What came of starting one.
pub enum Started {
    /// It waits for commands.
    Ready(Child),
    /// It says what is missing.
    Unavailable(String),
}

impl Child {
    /// Starts `python script arguments`, its messages going to `log`.
    ///
    /// # Errors
    /// When the log cannot be written, or `cancel` was set.
    pub fn start(python: &str, script: &Path, arguments: &[String], log: &Path, cancel: &AtomicBool) -> Result<Started> {
        let errors = File::create(log).with_context(|| log.display().to_string())?;
        let spawned =
            Command::new(python).arg(script).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(errors).spawn();
        let mut process = match spawned {
            Ok(process) => process,
            Err(error) => return Ok(Started::Unavailable(format!("{python} cannot be started: {error}"))),
        };
        let (Some(commands), Some(output)) = (process.stdin.take(), process.stdout.take()) else {
            bail!("{python} has no pipes")
        };
        let (sender, answers) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        let mut child = Self { process, commands, answers, version: String::new() };
        let greeting = match child.answer(cancel) {
            Ok(greeting) => greeting,
            Err(error) if error.is::<Interrupted>() => return Err(error),
            Err(error) => {
                return Ok(Started::Unavailable(format!(
                    "{}; see {}",
                    renderflow::util::console::message(&error),
                    log.display()
                )));
            }
        };
        if let Some(reason) = greeting["unavailable"].as_str() {
            return Ok(Started::Unavailable(reason.to_owned()));
        }
        match greeting["ready"]["version"].as_str() {
            Some(version) => child.version = version.to_owned(),
            None => return Ok(Started::Unavailable(format!("said {greeting} in place of its version"))),
        }
        Ok(Started::Ready(child))
    }

    /// Sends a command and waits for its answer.
    ///
    /// # Errors
    /// When the script answers with an error, or has ended, or `cancel` was set.
    pub fn ask(&mut self, command: &Value, cancel: &AtomicBool) -> Result<Value> {
        writeln!(self.commands, "{command}").and_then(|()| self.commands.flush()).context("it has ended")?;
        let answer = self.answer(cancel)?;
        match answer["error"].as_str() {
            Some(error) => bail!("{error}"),
            None => Ok(answer),
        }
    }

    fn answer(&mut self, cancel: &AtomicBool) -> Result<Value> {
        let started = Instant::now();
        loop {
            match self.answers.recv_timeout(Duration::from_millis(100)) {
                Ok(line) => return serde_json::from_str(&line).map_err(|e| anyhow!("said {line:?}, which is no answer: {e}")),
                Err(RecvTimeoutError::Disconnected) => bail!("it has ended"),
                Err(RecvTimeoutError::Timeout) if cancel.load(Ordering::Relaxed) => return Err(Interrupted.into()),
                Err(RecvTimeoutError::Timeout) if started.elapsed() > PATIENCE => bail!("no answer for an hour"),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Loads an exported scene. Returns what the script has to say about it.
    ///
    /// # Errors
    /// As [`Self::ask`].
    pub fn load(&mut self, scene: &Path, cancel: &AtomicBool) -> Result<Vec<String>> {
        let answer = self.ask(&json!({"load": scene}), cancel)?;
        let notes = answer["notes"].as_array().into_iter().flatten().filter_map(Value::as_str);
        Ok(notes.map(str::to_owned).collect())
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Killed and not asked: it may be in the middle of a long render.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
