//! `authros bench evidence`: bundles of synthetic records with the embedded chain's own proofs. Their bytes per record,
//! the proofs' bytes per batch, and their verification on all cores beside SM2 and SM3 of the same records.

mod made;
mod plots;
mod timed;

use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;
use serde_json::{Map, json};
use tokio::task::block_in_place;

use self::made::{Ground, MESSAGE, Made, Proofs};
use self::timed::{Times, each, times};
use super::account::Account;
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use crate::args::EvidenceArguments;
use authros_crypto::Provider;
use authros_output::table;
use authros_service::Failure;

/// Records of a batch, as the pipeline closes them under little load.
const WIDTH: usize = 256;
/// Records of the smaller bundles.
const SMALLER: [usize; 2] = [1, 100];
/// How many times as long as the reference checking may take.
const MOST: f64 = 1.3;

const NOTES: [&str; 6] = [
    "Records of 1 KiB of random bytes, sealed, signed and anchored by the program's own code in batches of 256 on an \
     embedded chain of one signer; proofs by its eth_getProof at each batch's block. No report.html, no time stamps, \
     nothing disclosed.",
    "bundle: bytes of the file per record. hour: one record a batch, a batch a block, as many as an hour has seconds; \
     proof bytes per batch are nodes of the state, each stored once, and the block's header.",
    "signers: one batch, each record by another registered account. prove: asking the chain for its proofs.",
    "reference: SM3 of each record and SM2 verification of its signature, on the same threads. read: archive, and \
     manifest with SM3 and SHA-256 of every member. check: from the bundle to the verdict. verify: both.",
    "The reference and the verification take turns; ratios are of the least times.",
    "A signer met before has a table in the process, in the reference as in the verification.",
];

/// One figure.
#[derive(Debug, Serialize)]
struct Row {
    /// `bundle`, `reference`, `read`, `check`, `verify`, `hour`, `signers` or `prove`.
    what: &'static str,
    records: usize,
    batches: usize,
    signers: usize,
    #[serde(flatten)]
    measured: Measured,
    /// Bytes altogether: of the file, or of the proofs.
    total_bytes: Option<u64>,
    /// Of these, nodes of the state.
    nodes_bytes: Option<u64>,
    /// By the least times.
    of_reference: Option<f64>,
    paper: Option<f64>,
}

/// A figure that must be reached.
#[derive(Debug, Serialize)]
struct Acceptance {
    what: String,
    limit: f64,
    found: f64,
    ok: bool,
}

/// Of how many records, batches and signers a row is.
#[derive(Clone, Copy)]
struct Of {
    records: usize,
    batches: usize,
    signers: usize,
}

/// Measures; [`Judgement::Missed`] if checking takes longer than it may.
///
/// # Errors
/// If the chain cannot be made, or a bundle does not hold.
pub async fn run(
    arguments: EvidenceArguments,
    provider: &'static dyn Provider,
    outlet: &Outlet,
) -> Result<Judgement, Failure> {
    let ground = Ground::new(provider).await?;
    let EvidenceArguments { records, batches, signers, runs } = arguments;
    let (records, batches, signers) = (records as usize, batches as usize, signers as usize);
    let mut work = Work::new(records, batches, signers);
    let mut results = Vec::new();
    for count in SMALLER.into_iter().filter(|count| *count < records).chain([records]) {
        results.extend(bundle(&ground, count, if count == records { runs } else { 0 }, &mut work).await?);
    }
    results.push(hour(&ground, batches, &mut work).await?);
    results.extend(many_signers(&ground, signers, runs, &mut work).await?);
    drop(work);
    let acceptance = acceptance(&results);
    let ok = acceptance.iter().all(|one| one.ok);
    let mut about = Map::new();
    about.insert("acceptance".to_owned(), json!(acceptance));
    about.insert("notes".to_owned(), json!(NOTES));
    let report = Report { name: "evidence", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report, &acceptance), || plots::page(&report))?;
    Ok(Judgement::reached(ok))
}

/// How far it is, in batches and registrations.
struct Work {
    progress: Progress,
    done: usize,
    all: usize,
}

impl Work {
    fn new(records: usize, batches: usize, signers: usize) -> Self {
        Self { progress: Progress::new("evidence"), done: 0, all: SMALLER.len() + records / WIDTH + batches + signers }
    }

    fn step(&mut self) {
        self.done += 1;
        self.progress.at(self.done, self.all);
    }
}

/// A bundle of one owner's records in batches, and its times if `runs` is not 0.
async fn bundle(ground: &Ground, records: usize, runs: u32, work: &mut Work) -> Result<Vec<Row>, Failure> {
    let owner = ground.owner();
    let (mut batches, mut proofs) = (Vec::new(), Proofs::new());
    let mut left = records;
    while left > 0 {
        let width = left.min(WIDTH);
        let batch = ground.anchor(&vec![Arc::clone(owner); width], owner).await?;
        ground.prove(&batch, &mut proofs).await?;
        batches.push(batch);
        left -= width;
        work.step();
    }
    let identities = ground.identities(std::slice::from_ref(owner)).await?;
    let made = block_in_place(|| ground.pack(&batches, &proofs, &identities))?;
    let of = Of { records, batches: batches.len(), signers: 1 };
    let mut rows = vec![file(of, "bundle", &made)];
    if runs > 0 {
        rows.extend(timed(of, &block_in_place(|| times(ground, &batches, &made, runs))?));
    }
    Ok(rows)
}

/// One batch a block, of one record each: what the proofs of one more batch add to a bundle.
async fn hour(ground: &Ground, count: usize, work: &mut Work) -> Result<Row, Failure> {
    let owner = std::slice::from_ref(ground.owner());
    let (mut batches, mut proofs) = (Vec::with_capacity(count), Proofs::new());
    for _ in 0..count {
        let batch = ground.anchor(owner, ground.owner()).await?;
        ground.prove(&batch, &mut proofs).await?;
        batches.push(batch);
        work.step();
    }
    let identities = ground.identities(owner).await?;
    let Made { nodes, headers, .. } = block_in_place(|| ground.pack(&batches, &proofs, &identities))?;
    let of = Of { records: count, batches: count, signers: 1 };
    let row = row(of, "hour", "bytes/batch", &[number(nodes + headers) / number(count)]);
    Ok(Row { total_bytes: Some((nodes + headers) as u64), nodes_bytes: Some(nodes as u64), ..row })
}

/// One batch of many signers, anchored by a gateway.
async fn many_signers(ground: &Ground, count: usize, runs: u32, work: &mut Work) -> Result<Vec<Row>, Failure> {
    let mut accounts: Vec<Arc<Account>> = Vec::with_capacity(count);
    for _ in 0..count {
        accounts.extend(ground.register(1).await?);
        work.step();
    }
    let gateway = &ground.network.accounts[1];
    let batch = [ground.anchor(&accounts, gateway).await?];
    let (mut proofs, begun) = (Proofs::new(), Instant::now());
    ground.prove(&batch[0], &mut proofs).await?;
    let prove = each(begun, count);
    let identities = ground.identities(&accounts).await?;
    let made = block_in_place(|| ground.pack(&batch, &proofs, &identities))?;
    let of = Of { records: count, batches: 1, signers: count };
    let mut rows = vec![file(of, "signers", &made), row(of, "prove", "us/record", &[prove])];
    rows.extend(timed(of, &block_in_place(|| times(ground, &batch, &made, runs))?));
    Ok(rows)
}

fn row(of: Of, what: &'static str, unit: &'static str, values: &[f64]) -> Row {
    let Of { records, batches, signers } = of;
    let measured = Measured { bytes: MESSAGE as u64, runs: values.len() as u64, unit, spread: Spread::of(values) };
    let (total_bytes, nodes_bytes, of_reference, paper) = (None, None, None, None);
    Row { what, records, batches, signers, measured, total_bytes, nodes_bytes, of_reference, paper }
}

fn file(of: Of, what: &'static str, made: &Made) -> Row {
    let row = row(of, what, "bytes/record", &[number(made.file.len()) / number(of.records)]);
    Row { total_bytes: Some(made.file.len() as u64), nodes_bytes: Some(made.nodes as u64), ..row }
}

fn timed(of: Of, times: &Times) -> Vec<Row> {
    let least = Spread::of(&times.reference).min;
    let all =
        [("reference", &times.reference), ("read", &times.read), ("check", &times.check), ("verify", &times.verify)];
    let timed = all.into_iter().map(|(what, values)| {
        let row = row(of, what, "us/record", values);
        Row { of_reference: Some(row.measured.spread.min / least), ..row }
    });
    timed.collect()
}

/// Of the largest bundle of one signer.
fn acceptance(rows: &[Row]) -> Vec<Acceptance> {
    let found = rows.iter().find(|row| row.what == "check" && row.signers == 1);
    let ratio = found.and_then(|row| Some((row.records, row.of_reference?)));
    let judged = ratio.map(|(records, found)| Acceptance {
        what: format!("checking {records} records over SM2 and SM3 of the same, at most"),
        limit: MOST,
        found,
        ok: found <= MOST,
    });
    judged.into_iter().collect()
}

fn text(report: &Report<Row>, acceptance: &[Acceptance]) -> String {
    let head = [
        "what",
        "records",
        "batches",
        "signers",
        "min",
        "p50",
        "max",
        "unit",
        "bytes",
        "of them nodes",
        "of reference",
    ];
    let rows: Vec<Vec<String>> = report.results.iter().map(cells).collect();
    let mut lines = vec![
        "evidence: bundles of records of 1 KiB, and their verification on all cores".to_owned(),
        format!("machine: {}", report.machine.line()),
        String::new(),
        table(&head, &rows),
        String::new(),
    ];
    for one in acceptance {
        let answer = if one.ok { "yes" } else { "NO" };
        lines.push(format!("{} {}: {answer} ({:.2})", one.what, one.limit, one.found));
    }
    lines.push(String::new());
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn cells(row: &Row) -> Vec<String> {
    let Spread { min, p50, max, .. } = row.measured.spread;
    let mut cells = vec![row.what.to_owned()];
    cells.extend([row.records, row.batches, row.signers].map(|count| count.to_string()));
    cells.extend([min, p50, max].map(decimal));
    cells.push(row.measured.unit.to_owned());
    let bytes = |bytes: Option<u64>| bytes.map_or("-".to_owned(), |bytes| bytes.to_string());
    cells.extend([bytes(row.total_bytes), bytes(row.nodes_bytes)]);
    cells.push(row.of_reference.map_or("-".to_owned(), |ratio| format!("{ratio:.2}")));
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_checking_the_bundle_of_one_signer_is_judged() {
        let of = |signers| Of { records: 10, batches: 1, signers };
        let times = |check: f64| Times {
            reference: vec![10.0, 20.0],
            read: vec![30.0, 30.0],
            check: vec![check, 99.0],
            verify: vec![check + 30.0, 129.0],
        };
        let rows = |check: f64| -> Vec<Row> {
            timed(of(1), &times(check)).into_iter().chain(timed(of(10), &times(90.0))).collect()
        };
        let judged = |check: f64| acceptance(&rows(check)).iter().map(|one| (one.found, one.ok)).collect::<Vec<_>>();
        assert_eq!(judged(13.0), [(1.3, true)]);
        assert_eq!(judged(14.0), [(1.4, false)]);
        assert!(acceptance(&[]).is_empty());
    }
}
