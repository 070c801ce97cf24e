//! `authros serve --detach`: the site in a process of its own, which outlives the terminal and the one that began it.

use std::fs::{File, OpenOptions};
use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use super::connect::Context;
use crate::model::ErrorKind;
use crate::service::Failure;
use crate::store::files;
use authros_output::Output;

/// This very program, also if its file was replaced since.
pub const OWN_PROGRAM: &str = "/proc/self/exe";
/// Warnings of earlier sites are kept up to this size, bytes.
const LONGEST_LOG: u64 = 1 << 20;
/// The most that is read of the process's first line, bytes.
const LONGEST: u64 = 64 * 1024;

/// Starts the same command without `--detach`, and returns when it serves or has ended.
///
/// # Errors
/// If it cannot be started, or says nothing that is understood.
pub fn run(context: &Context, output: &Output) -> Result<u8, Failure> {
    files::private_directory(context.home.root())?;
    let log = context.home.serve_log();
    let file = private_file(&log).map_err(|error| {
        Failure::new(ErrorKind::Home, format!("{} cannot be written: {error}; nothing was started", log.display()))
    })?;
    let mut child = start(context, file)?;
    let first = first_line(&mut child);
    match first.as_deref().and_then(|line| serde_json::from_str::<Value>(line).ok()) {
        Some(mut said) if said.get("serving").is_some() => {
            said["process"] = Value::from(child.id());
            output.result(&said, || text(&said, child.id(), &log.display().to_string()));
            Ok(0)
        }
        said => ended(child, said.as_ref(), &log.display().to_string(), output),
    }
}

fn private_file(path: &std::path::Path) -> std::io::Result<File> {
    // A site that runs already may be writing there.
    let file = OpenOptions::new().append(true).create(true).mode(0o600).open(path)?;
    if file.metadata()?.len() > LONGEST_LOG {
        file.set_len(0)?;
    }
    Ok(file)
}

fn start(context: &Context, log: File) -> Result<Child, Failure> {
    let words = std::env::args_os().skip(1).filter(|word| word != "--detach");
    let json = (!context.global.json).then_some("--json");
    // A descriptor is read by the process that needs the passphrase, and by no other.
    let input = if context.global.passphrase_fd.is_some() { Stdio::inherit() } else { Stdio::null() };
    let mut command = Command::new(OWN_PROGRAM);
    command.args(words).args(json).arg("--own-session").stdin(input).stdout(Stdio::piped()).stderr(log);
    command.spawn().map_err(|error| {
        Failure::new(ErrorKind::Internal, format!("the site's process cannot be started: {error}; try `authros serve`"))
    })
}

/// Waits until it serves, or has ended: then there is no line, or one that says why.
fn first_line(child: &mut Child) -> Option<String> {
    let mut line = String::new();
    let output = child.stdout.take()?;
    BufReader::new(output.take(LONGEST)).read_line(&mut line).ok()?;
    Some(line)
}

fn text(said: &Value, process: u32, log: &str) -> String {
    let word = |name: &str| said.get(name).and_then(Value::as_str).unwrap_or_default().to_owned();
    let master = word("ros_master");
    let ros = if master.is_empty() { String::new() } else { format!("\nROS nodes join with ROS_MASTER_URI={master}") };
    format!(
        "serving {} for profile '{}' in process {process}\nstop it with: kill -INT {process}\nwarnings go to {log}{ros}",
        word("serving"),
        word("profile"),
    )
}

/// The same end as the process had, in its words.
fn ended(mut child: Child, said: Option<&Value>, log: &str, output: &Output) -> Result<u8, Failure> {
    let status = child.wait().map_err(|error| {
        Failure::new(ErrorKind::Internal, format!("the end of the site's process cannot be read: {error}"))
    })?;
    let message = said.and_then(|said| said.pointer("/error/message")).and_then(Value::as_str);
    let reason =
        message.map_or_else(|| format!("its process ended ({status}); {log} has what it wrote"), str::to_owned);
    output.note(&format!("authros: nothing was left running: {reason}"));
    let code = status.code().and_then(|code| u8::try_from(code).ok()).filter(|code| *code != 0);
    Ok(code.unwrap_or_else(|| ErrorKind::Internal.exit_code()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_serves_says_where_and_how_it_is_stopped() {
        let said = serde_json::json!({ "serving": "/h", "profile": "bob", "ros_master": null });
        let text = text(&said, 77, "/h/serve.log");
        assert!(text.contains("process 77") && text.contains("kill -INT 77") && text.contains("'bob'"), "{text}");
        assert!(!text.contains("ROS_MASTER_URI"), "{text}");
    }
}
