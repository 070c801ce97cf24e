//! `doctor`, `backup restore`, `evidence verify` of a folder, and the audit of records: what their arguments mean, results for people.

use std::path::Path;
use std::time::Duration;

use super::{args::Global, connect::Context, parse, passphrase, show::Question};
use crate::model::{ErrorKind, counted, grouped};
use crate::service::command::{ChainStatus, ListAllUploads, ListUploads, SiteStatus, UploadQuery};
use crate::service::reply::{BackupView, CheckStatus, DoctorView, RecordAudit};
use crate::service::verification::{self, FolderCheck, Known, verdict};
use crate::service::{Failure, doctor, restoring, socket};
use crate::store::SiteLock;
use authros_output::{Output, table};

pub fn list_uploads(context: &Context, query: UploadQuery) -> Question {
    // Ids of tags derive from each profile's own key.
    let of_one = context.global.profile.is_some()
        || context.operator.is_some()
        || !query.tags.is_empty()
        || query.incident.is_some()
        || context.home.profiles().len() < 2;
    if of_one { ListUploads(query).into() } else { ListAllUploads(query).into() }
}

fn rounded(value: f64) -> String {
    if value < 10.0 { format!("{value:.1}") } else { format!("{value:.0}") }
}

pub fn audit(audit: &RecordAudit) -> String {
    let how = if audit.deep { "re-hashed, signatures checked" } else { "compared (rows, proofs, chain)" };
    let (megabytes, threads) = (rounded(audit.megabytes_per_second), counted(audit.threads as u64, "thread"));
    let mut lines = vec![
        format!(
            "{} {how}, {}, in {:.1} s",
            counted(audit.records, "record"),
            counted(audit.bytes, "byte"),
            audit.seconds
        ),
        format!("{} records/s, {megabytes} MB/s on {threads}", rounded(audit.records_per_second)),
        format!(
            "{} checked against the chain, {}",
            counted(audit.batches, "batch"),
            counted(audit.audit_lines, "audit log line")
        ),
    ];
    let others = [
        (audit.pending, "not on a chain yet"),
        (audit.given_up, "deliberately discarded"),
        (audit.unchecked, "signed with keys unknown here"),
    ];
    let others = others.into_iter().filter(|(count, _)| *count > 0);
    lines.extend(others.map(|(count, what)| format!("{} {what}", counted(count, "record"))));
    lines.extend(audit.notes.iter().map(|note| format!("note: {note}")));
    let find = |finding: &crate::service::reply::RecordFinding| {
        format!("{}: {}: {}", finding.kind.word().to_uppercase(), finding.subject, finding.text)
    };
    lines.extend(audit.findings.iter().map(find));
    if audit.findings_left_out > 0 {
        lines.push(format!("and {} more", audit.findings_left_out));
    }
    let (missing, tampered, gaps) = (grouped(audit.missing), grouped(audit.tampered), counted(audit.gaps, "number"));
    lines.push(match audit.ok {
        true => "nothing missing, nothing tampered with".to_owned(),
        false if audit.worst() == Some(ErrorKind::Refused) => {
            format!(
                "nothing missing, nothing tampered with; {} with a false name",
                counted(audit.false_names, "record")
            )
        }
        false => format!("{missing} missing, {tampered} tampered, {gaps} absent; keep a copy of the home"),
    });
    lines.join("\n")
}

pub fn audit_code(audit: &RecordAudit) -> u8 {
    audit.worst().map_or(0, ErrorKind::exit_code)
}

pub fn backed_up(view: &BackupView) -> String {
    let profiles = if view.profiles.is_empty() { "no profile".to_owned() } else { view.profiles.join(", ") };
    let (files, bytes) = (counted(view.files, "file"), counted(view.bytes, "byte"));
    let mut lines = vec![format!("{}: {files}, {bytes}, keyrings of {profiles}", view.file)];
    lines.extend(view.notes.iter().map(|note| format!("note: {note}")));
    lines.join("\n")
}

/// Longest wait of the doctor for what a site says of its chain.
const PATIENCE: Duration = Duration::from_secs(5);

pub async fn run_doctor(context: Context, output: &Output) -> Result<u8, Failure> {
    let site = running_site(&context).await;
    let view = doctor::examine(&context.home, &context.config, site).await;
    output.result(&view, || doctor_text(&view));
    Ok(view.kind.map_or(0, ErrorKind::exit_code))
}

/// `None` if no site runs.
async fn running_site(context: &Context) -> Option<Result<doctor::Running, String>> {
    if !context.home.site_lock().exists() || matches!(SiteLock::acquire(&context.home.site_lock()), Ok(Some(_))) {
        return None;
    }
    let joined = match socket::join(&context.home, context.profile.clone()).await {
        Ok(Some((client, _))) => match client.ask(SiteStatus).await {
            Ok(site) => {
                // The site itself reports a chain that is away.
                let chain = tokio::time::timeout(PATIENCE, client.ask(ChainStatus)).await;
                Ok(doctor::Running { site, chain: chain.ok().and_then(Result::ok) })
            }
            Err(failure) => Err(failure),
        },
        Ok(None) => return Some(Err("its socket is missing".to_owned())),
        Err(failure) => Err(failure),
    };
    Some(joined.map_err(|failure| failure.message))
}

fn doctor_text(view: &DoctorView) -> String {
    let mut lines = Vec::new();
    let width = view.checks.iter().map(|check| check.name.len()).max().unwrap_or(0);
    for check in &view.checks {
        let word = match check.status {
            CheckStatus::Ok => "ok  ",
            CheckStatus::Warn => "warn",
            CheckStatus::Fail => "FAIL",
        };
        lines.push(format!("{word}  {:width$}  {}", check.name, check.detail));
        if !check.advice.is_empty() {
            lines.push(format!("      {:width$}  -> {}", "", check.advice));
        }
    }
    lines.join("\n")
}

pub async fn verify_folder(
    global: &Global,
    folder: &Path,
    genesis: Option<&str>,
    output: &Output,
) -> Result<u8, Failure> {
    let set = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let url = global.chain.clone().or_else(|| set("AUTHROS_CHAIN"));
    let contract = parse::optional(global.contract.as_deref())?;
    let genesis = genesis.map(parse::value).transpose()?;
    let check = verification::verify(folder, url.as_deref(), Known { genesis, contract }).await?;
    output.result(&check, || verify_text(&check));
    Ok(check.worst.map_or(0, ErrorKind::exit_code))
}

fn verify_text(check: &FolderCheck) -> String {
    let row = |step: &crate::pipeline::export_folder::VerifyStep| {
        let word = match step.ok {
            Some(true) => "holds",
            Some(false) => "FAILED",
            None => "not checked",
        };
        [step.name.clone(), word.to_owned(), step.text.clone()]
    };
    let steps = table(&["step", "", ""], check.steps.iter().map(row));
    format!("{steps}\n{}", verdict(check))
}

pub fn run_restore(context: &Context, file: &Path, output: &Output) -> Result<u8, Failure> {
    if context.config.store_url.is_some() {
        let text = "a backup is restored into a home with a file of its own, and store.url names a database; leave it empty, \
                    or restore the database with PostgreSQL's own tools";
        return Err(Failure::new(ErrorKind::Refused, text));
    }
    let passphrase = passphrase::of_backup(&context.global, false)?;
    let view = restoring::restore(file, &context.home, &passphrase)?;
    output.result(&view, || backed_up(&view));
    Ok(0)
}
