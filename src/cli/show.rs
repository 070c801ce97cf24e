//! Answers of the site, printed for people or as JSON; files written if a verb requested some.

use std::{fs::OpenOptions, io::Write as _, os::unix::fs::OpenOptionsExt as _, path::Path};

use super::{
    audit, chain, check, coverage, gateway, grants, identity, incidents, keys, parties, quarantine, reading, records,
    robots, rules, status, topics,
};
use crate::service::command::{Ask, Command, SecretBytes};
use crate::service::{Client, Failure, reply, reply::input};
use crate::{crypto::private_file, model::Clock, model::ErrorKind};
use authros_output::Output;

pub fn yes(value: bool) -> String {
    if value { "yes" } else { "no" }.to_owned()
}

pub fn or_dash<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| value.to_string())
}

pub trait Printed: reply::Answer {
    /// `out` is the place for files; returns the exit code.
    fn print(self, out: Option<&Path>, output: &Output) -> Result<u8, Failure>;
}

type Print = fn(Result<reply::Reply, Failure>, Option<&Path>, &Output) -> Result<u8, Failure>;

pub struct Question {
    pub command: Command,
    print: Print,
}

impl<A> From<A> for Question
where
    A: Ask,
    A::Answer: Printed,
{
    fn from(ask: A) -> Self {
        Self { command: ask.into(), print: |reply, out, output| A::heard(reply)?.print(out, output) }
    }
}

impl Question {
    pub async fn ask(self, client: &Client) -> Told {
        Told { reply: client.request(self.command).await, print: self.print }
    }
}

pub struct Told {
    pub reply: Result<reply::Reply, Failure>,
    print: Print,
}

impl Told {
    pub fn print(self, out: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        (self.print)(self.reply, out, output)
    }
}

/// Answers printed as one document: their text, and their exit code if not 0.
macro_rules! documents {
    ($($view:ty => $text:expr $(, $code:path)?;)+) => {$(
        impl Printed for $view {
            fn print(self, _: Option<&Path>, output: &Output) -> Result<u8, Failure> {
                let text: fn(&Self) -> String = $text;
                output.result(&self, || text(&self));
                Ok([0_u8, $($code(&self))?].into_iter().sum())
            }
        }
    )+};
}

/// Answers printed as rows, and their name in JSON.
macro_rules! rows {
    ($($row:ty, $name:literal => $text:path;)+) => {$(
        impl Printed for Vec<$row> {
            fn print(self, _: Option<&Path>, output: &Output) -> Result<u8, Failure> {
                output.result(&serde_json::json!({ $name: self }), || $text(&self));
                Ok(0)
            }
        }
    )+};
}

documents! {
    reply::IdentityView => identity::one;
    reply::KeyChangeView => |view| view.lines.join("\n");
    reply::GrantForesight => grants::foreseen;
    reply::KeysView => keys::list;
    reply::RecordPage => records::page;
    reply::Provenance => records::provenance;
    reply::TransactionView => |view| view.words(&Clock::system());
    Box<reply::ChainView> => |view| chain::status(view);
    Box<reply::AdministrationView> => |view| parties::successions(view);
    reply::DeployedView => chain::deployed;
    reply::BackupView => check::backed_up;
    reply::GatewayStatusView => gateway::status;
    reply::AlertsView => status::standing;
    reply::AlertTestView => |view| format!("{} accepted it: {}", view.place, view.text);
    reply::PinsView => quarantine::pins;
    reply::QuarantineView => quarantine::held;
    reply::DecidedView => |view| view.text.clone();
    reply::PathView => reading::path;
    reply::DeviceAddressesView => device_addresses;
    reply::DeviceTopicsView => device_topics;
    reply::IncidentView => incidents::incident;
    reply::RingPullView => robots::pulled;
    reply::RobotView => robots::one;
    reply::CompareView => parties::comparison, parties::comparison_code;
    reply::AuditCheck => audit::check, audit::code;
    Box<reply::RecordAudit> => |audit| check::audit(audit), check::audit_code;
}

rows! {
    reply::TopicRow, "topics" => topics::list;
    reply::CoverageView, "coverage" => coverage::strips;
    reply::GrantRow, "grants" => grants::list;
    reply::DeviceRow, "devices" => robots::devices;
    reply::ContactRow, "contacts" => parties::contact_table;
    reply::AuditView, "audit" => audit::lines;
    reply::AdmittedView, "allowed" => gateway::allowed;
    reply::IncidentView, "incidents" => incidents::all;
    reply::RobotRow, "robots" => robots::all;
}

impl Printed for () {
    fn print(self, _: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        output.result(&serde_json::json!({ "ok": true }), || "done".to_owned());
        Ok(0)
    }
}

impl Printed for reply::CheckView {
    fn print(self, _: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        output.result(&self, || {
            let contract = self.contract.map_or_else(String::new, |answer| format!("\n{}", answer.text()));
            format!("{}{contract}", records::verdict(&self))
        });
        Ok(records::verdict_code(self.verdict))
    }
}

impl Printed for Box<reply::OpenedView> {
    fn print(mut self, out: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        let file = out.zip(self.file.take());
        if let Some((path, bytes)) = &file {
            // Only the owner may read it.
            let file = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(path);
            file.and_then(|mut file| file.write_all(bytes)).map_err(|error| not_written(path, &error))?;
        }
        reading::without_bytes(&mut self);
        output.result(&self, || match &file {
            Some((path, bytes)) => {
                let written = format!("{} bytes written to {} (0600)", bytes.len(), path.display());
                [reading::head(&self), vec![written]].concat().join("\n")
            }
            None => reading::opened(&self),
        });
        Ok(records::verdict_code(self.verdict))
    }
}

impl Printed for Vec<reply::ExportedFile> {
    fn print(self, out: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        let directory = out.unwrap_or(Path::new("."));
        std::fs::create_dir_all(directory).map_err(|error| not_written(directory, &error))?;
        // All or nothing: files of two records side by side would prove nothing.
        if let Some(there) = self.iter().map(|file| directory.join(&file.name)).find(|path| path.exists()) {
            let what = "exists and will not be overwritten; choose another folder with --dir";
            return Err(input(format!("{} {what}", there.display())));
        }
        for file in &self {
            let path = directory.join(&file.name);
            let made = std::fs::File::create_new(&path);
            let written = made.and_then(|mut made| made.write_all(&file.bytes));
            written.map_err(|error| not_written(&path, &error))?;
        }
        let names: Vec<&str> = self.iter().map(|file| file.name.as_str()).collect();
        let written = serde_json::json!({ "directory": directory.display().to_string(), "files": names });
        output.result(&written, || format!("{} written to {}", names.join(", "), directory.display()));
        Ok(0)
    }
}

impl Printed for SecretBytes {
    fn print(self, out: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        let nowhere = || Failure::new(ErrorKind::Usage, "a key is written to a file; give it with --out");
        let path = out.ok_or_else(nowhere)?;
        private_file::create_private(path, self.expose())?;
        output.result(&serde_json::json!({ "file": path.display().to_string() }), || {
            format!("written to {} (0600)", path.display())
        });
        Ok(0)
    }
}

impl Printed for reply::PolicyView {
    fn print(self, _: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        output.result(&self, || rules::text(&self));
        Ok(0)
    }
}

fn device_topics(view: &reply::DeviceTopicsView) -> String {
    let (added, topics) = (view.added.join(", "), view.topics.join(", "));
    format!("'{}' is being sent the keys of {added}; it covers {topics}", view.name)
}

fn device_addresses(view: &reply::DeviceAddressesView) -> String {
    format!("'{}' uses the first address that answers of {}", view.name, view.gateway.addresses.join(", "))
}

pub fn not_written(path: &Path, error: &std::io::Error) -> Failure {
    input(format!("{} cannot be written: {error}", path.display()))
}
