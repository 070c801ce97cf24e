//! Answers of the site, printed for people or as JSON; files written where a verb asked for some.

use std::path::Path;

use super::{lists, parties, quarantine};
use crate::crypto::private_file;
use crate::model::ErrorKind;
use crate::service::{Failure, Reply};
use authros_output::Output;

/// Prints an answer; `out` is where its files go. The exit code.
///
/// # Errors
/// A file that cannot be written.
#[allow(clippy::too_many_lines, reason = "a line for each answer")]
pub fn show(reply: Reply, out: Option<&Path>, output: &Output) -> Result<u8, Failure> {
    match reply {
        Reply::Done => output.result(&serde_json::json!({ "ok": true }), || "done".to_owned()),
        Reply::Identity(view) => output.result(&view, || lists::identity(&view)),
        Reply::KeyChange(view) => output.result(&view, || view.lines.join("\n")),
        Reply::Keys(view) => output.result(&view, || lists::keys(&view)),
        Reply::Topics(rows) => output.result(&serde_json::json!({ "topics": rows }), || lists::topics(&rows)),
        Reply::Records(page) => output.result(&page, || lists::records(&page)),
        Reply::Provenance(view) => output.result(&view, || lists::provenance(&view)),
        Reply::Transaction(view) => output.result(&view, || view.text.clone()),
        Reply::Grants(rows) => output.result(&serde_json::json!({ "grants": rows }), || lists::grants(&rows)),
        Reply::Devices(rows) => {
            output.result(&serde_json::json!({ "devices": rows }), || super::adopt::devices(&rows));
        }
        Reply::Chain(view) => output.result(&view, || lists::chain(&view)),
        Reply::Administration(view) => output.result(&view, || parties::successions(&view)),
        Reply::Deployed(view) => output.result(&view, || lists::deployed(&view)),
        Reply::Contacts(rows) => {
            output.result(&serde_json::json!({ "contacts": rows }), || parties::contact_table(&rows));
        }
        Reply::Compared(view) => {
            output.result(&view, || parties::comparison(&view));
            return Ok(parties::comparison_code(&view));
        }
        Reply::Audit(lines) => {
            output.result(&serde_json::json!({ "audit": lines }), || super::audit::lines(&lines));
        }
        Reply::AuditChecked(check) => {
            output.result(&check, || super::audit::check(&check));
            return Ok(super::audit::code(&check));
        }
        Reply::RecordsAudited(audit) => {
            output.result(&audit, || super::check::audit(&audit));
            return Ok(super::check::audit_code(&audit));
        }
        Reply::BackedUp(view) => output.result(&view, || super::check::backed_up(&view)),
        Reply::Admitted(rows) => {
            output.result(&serde_json::json!({ "admitted": rows }), || super::gateway::admitted(&rows));
        }
        Reply::GatewayStatus(view) => output.result(&view, || super::gateway::status(&view)),
        Reply::Pins(view) => output.result(&view, || quarantine::pins(&view)),
        Reply::Quarantine(view) => output.result(&view, || quarantine::held(&view)),
        Reply::Decided(view) => output.result(&view, || view.text.clone()),
        Reply::Check(view) => {
            output.result(&view, || format!("{}: {}", view.id, view.verdict.word()));
            return Ok(lists::verdict_code(view.verdict));
        }
        Reply::Opened(mut view) => {
            if let (Some(path), Some(bytes)) = (out, view.file.take()) {
                write_new(path, &bytes)?;
            }
            super::viewing::without_bytes(&mut view);
            output.result(&view, || super::viewing::opened(&view));
            return Ok(lists::verdict_code(view.verdict));
        }
        Reply::Path(view) => output.result(&view, || super::viewing::path(&view)),
        Reply::Files(files) => {
            let directory = out.unwrap_or(Path::new("."));
            std::fs::create_dir_all(directory).map_err(|error| not_written(directory, &error))?;
            for file in &files {
                let path = directory.join(&file.name);
                std::fs::write(&path, &file.bytes).map_err(|error| not_written(&path, &error))?;
            }
            let names: Vec<&str> = files.iter().map(|file| file.name.as_str()).collect();
            let written = serde_json::json!({ "directory": directory.display().to_string(), "files": names });
            output.result(&written, || format!("{} written to {}", names.join(", "), directory.display()));
        }
        Reply::Key(secret) => {
            let path = out.ok_or_else(super::connect::unexpected)?;
            private_file::create_private(path, secret.expose())?;
            output.result(&serde_json::json!({ "file": path.display().to_string() }), || {
                format!("written to {} (0600)", path.display())
            });
        }
        Reply::DeviceTopics(view) => output.result(&view, || {
            let (added, topics) = (view.added.join(", "), view.topics.join(", "));
            format!("'{}' is sent the keys of {added}; it covers {topics}", view.name)
        }),
        Reply::Policy(view) => super::policy::show(&view, output),
        Reply::Recording(_) => return Err(super::connect::unexpected()),
        Reply::Site(_) | Reply::Enrolled(_) | Reply::Captured(_) | Reply::Served(_) | Reply::Gateway(_) => {
            return Err(super::connect::unexpected());
        }
    }
    Ok(0)
}

fn not_written(path: &Path, error: &std::io::Error) -> Failure {
    Failure::new(ErrorKind::Input, format!("{} cannot be written: {error}", path.display()))
}

fn write_new(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|error| not_written(path, &error))
}
