//! `authros bench all`: every bench, one after the other, shortened to a few minutes; one set of figures and plots.

use std::time::Instant;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::machine::Machine;
use super::measure;
use super::outlet::Outlet;
use super::report::Report;
use crate::Global;
use crate::args::{
    AlgorithmArguments, AllArguments, Bench, BenchName, ConsensusArguments, EvidenceArguments, GatewayArguments,
    GrowthArguments, LoadChoice, MemoryArguments, NetworkChoice, PipelineArguments, RecordArguments, SizeArguments,
};
use authros_crypto::Provider;
use authros_model::Consensus;
use authros_output::table;
use authros_service::Failure;

/// The outcome of one bench of the set.
#[derive(Debug, Serialize)]
struct Entry {
    bench: &'static str,
    what: &'static str,
    seconds: f64,
    /// Exit code as if it had run alone with `--judge`.
    code: u8,
    /// Why it could not be measured.
    error: Option<String>,
}

/// Every bench in its order, with what it measures in this set.
const PLAN: [(BenchName, &str, &str); 13] = [
    (BenchName::Sm3, "sm3", "digests of 1 KB to 800 KB beside libsm, libgcrypt and the paper"),
    (BenchName::Sm4, "sm4", "sealing and opening of 1 KB to 800 KB beside the crates, libsm and libgcrypt"),
    (BenchName::Sm2, "sm2", "signatures and envelopes beside the crate, libsm and OpenSSL"),
    (BenchName::Record, "record", "one record sealed, opened and verified on one core, step by step"),
    (BenchName::Gas, "gas", "gas per record: each, batches, the prototype's way"),
    (BenchName::Consensus, "consensus", "300 uploads at once on PoA and PoW"),
    (BenchName::Size, "size", "uploads of 1 to 8 KB on PoA and PoW: ours and the prototype's way"),
    (BenchName::Gateway, "gateway", "256 records of 1 KiB by each way of uploading; 200 idle connections"),
    (BenchName::Pipeline, "pipeline", "10 s of messages and 10 s of pictures, publisher to verified"),
    (BenchName::Memory, "memory", "memory of 200 idle robots, 200 watched topics, 10^5 records"),
    (BenchName::Pictures, "pictures", "raw pictures, clouds and small messages by codec"),
    (BenchName::Growth, "growth", "a record, a page and a frame with 10^3 to 10^5 records there"),
    (BenchName::Evidence, "evidence", "bundles of 1 to 10^4 records: bytes, and verification beside SM2 and SM3 alone"),
];

/// Runs all that is not skipped; the exit code is the first one that is not 0, of those that failed or, where figures are
/// judged, of all.
///
/// # Errors
/// None of its own: a bench's error is reported, and the next one begins.
pub async fn run(
    global: Global<'_>,
    arguments: AllArguments,
    provider: &'static dyn Provider,
    outlet: Outlet,
    judge: bool,
) -> Result<u8, Failure> {
    let plan: Vec<_> = PLAN.into_iter().filter(|(name, ..)| !arguments.skip.contains(name)).collect();
    if arguments.plan {
        show_plan(&plan, &outlet);
        return Ok(0);
    }
    let (outlet, begun) = (outlet.gathering(), Instant::now());
    let mut entries: Vec<Entry> = Vec::new();
    for (turn, (name, bench, what)) in plan.iter().enumerate() {
        outlet.note(&format!("bench {bench} ({} of {}): {what}", turn + 1, plan.len()));
        let started = Instant::now();
        let done = measure(global, short(*name, &arguments), provider, &outlet, None).await;
        let (code, error) = match done {
            Ok(judgement) => (judgement.exit_code(), None),
            Err(failure) => (failure.kind.exit_code(), Some(failure.message)),
        };
        if let Some(error) = &error {
            outlet.note(&format!("authros: bench {bench}: {error}"));
        }
        entries.push(Entry { bench, what, seconds: started.elapsed().as_secs_f64(), code, error });
    }
    let document = document(&entries, &outlet.gathered(), begun.elapsed().as_secs_f64());
    outlet.tell(&document, || text(&entries));
    Ok(ended(&entries, judge))
}

fn ended(entries: &[Entry], judge: bool) -> u8 {
    let counted = entries.iter().filter(|entry| judge || entry.error.is_some());
    counted.map(|entry| entry.code).find(|code| *code != 0).unwrap_or(0)
}

/// A bench with arguments that keep it short.
fn short(name: BenchName, arguments: &AllArguments) -> Bench {
    let algorithm = AlgorithmArguments { runs: arguments.runs };
    let node = arguments.node.clone();
    match name {
        BenchName::Sm2 => Bench::Sm2(algorithm),
        BenchName::Sm3 => Bench::Sm3(algorithm),
        BenchName::Sm4 => Bench::Sm4(algorithm),
        BenchName::Record => Bench::Record(RecordArguments { runs: arguments.runs }),
        BenchName::Gas => Bench::Gas,
        BenchName::Consensus => Bench::Consensus(ConsensusArguments {
            uploaders: vec![300],
            node,
            period: ConsensusArguments::PERIOD,
            difficulty: Consensus::PAPER_DIFFICULTY,
            funder: None,
        }),
        BenchName::Size => {
            let networks = vec![NetworkChoice::Poa, NetworkChoice::Pow];
            Bench::Size(SizeArguments { runs: arguments.runs, networks, node, funder: None })
        }
        BenchName::Gateway => Bench::Gateway(GatewayArguments { records: 256, idle: 200 }),
        BenchName::Pipeline => Bench::Pipeline(PipelineArguments {
            length: "10s".to_owned(),
            load: LoadChoice::Both,
            rate: 1000,
            bytes: 1024,
            before: 0,
            doubling: false,
            publishers: 4,
        }),
        BenchName::Memory => Bench::Memory(MemoryArguments { idle_robots: 200, topics: 200, records: 100_000 }),
        BenchName::Pictures => Bench::Pictures,
        BenchName::Growth => Bench::Growth(GrowthArguments { records: 100_000 }),
        BenchName::Evidence => {
            Bench::Evidence(EvidenceArguments { records: 10_000, batches: 300, signers: 100, runs: 3 })
        }
    }
}

fn show_plan(plan: &[(BenchName, &'static str, &'static str)], outlet: &Outlet) {
    let rows: Vec<Vec<String>> = plan.iter().map(|(_, bench, what)| vec![(*bench).into(), (*what).into()]).collect();
    let results: Vec<Value> = plan.iter().map(|(_, bench, what)| json!({ "bench": bench, "what": what })).collect();
    let report = Report { name: "all", machine: Machine::read(), about: Map::new(), results };
    outlet.tell(&json!(report), || table(&["bench", "what"], &rows));
}

/// All results, each with its bench; and each bench's description of itself.
fn document(entries: &[Entry], reports: &[Value], seconds: f64) -> Value {
    let mut results = Vec::new();
    let mut benches = Vec::new();
    for report in reports {
        let mut about = report.as_object().cloned().unwrap_or_default();
        let rows = about.remove("results").and_then(|rows| rows.as_array().cloned()).unwrap_or_default();
        for mut row in rows {
            if let Value::Object(fields) = &mut row {
                fields.insert("bench".to_owned(), report["name"].clone());
            }
            results.push(row);
        }
        about.remove("machine");
        benches.push(Value::Object(about));
    }
    let mut about = Map::new();
    about.insert("seconds".to_owned(), json!(seconds));
    about.insert("ran".to_owned(), json!(entries));
    about.insert("benches".to_owned(), json!(benches));
    json!(Report { name: "all", machine: Machine::read(), about, results })
}

fn text(entries: &[Entry]) -> String {
    let row = |entry: &Entry| {
        let verdict = match (&entry.error, entry.code) {
            (Some(error), code) => format!("{code}: {error}"),
            (None, 0) => "ok".to_owned(),
            (None, code) => format!("{code}: a target was missed, or something failed; see above"),
        };
        vec![entry.bench.to_owned(), format!("{:.0}", entry.seconds), verdict]
    };
    let rows: Vec<Vec<String>> = entries.iter().map(row).collect();
    format!("\n{}", table(&["bench", "seconds", "verdict"], &rows))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_a_set_name_their_bench() {
        let report = |name: &str| json!({ "name": name, "machine": {}, "notes": ["n"], "results": [{ "bytes": 1 }] });
        let entry = Entry { bench: "a", what: "w", seconds: 1.0, code: 0, error: None };
        let document = document(&[entry], &[report("a"), report("b")], 2.0);
        assert_eq!(document["results"], json!([{ "bench": "a", "bytes": 1 }, { "bench": "b", "bytes": 1 }]));
        assert_eq!(document["benches"], json!([{ "name": "a", "notes": ["n"] }, { "name": "b", "notes": ["n"] }]));
        assert!(document["machine"]["cores"].is_u64() && document["ran"][0]["code"] == 0, "{document}");
    }

    #[test]
    fn a_bench_that_failed_ends_the_set_and_a_figure_only_where_it_is_judged() {
        let entry = |code, error: Option<&str>| Entry {
            bench: "a",
            what: "w",
            seconds: 1.0,
            code,
            error: error.map(ToOwned::to_owned),
        };
        let missed = [entry(0, None), entry(1, None), entry(8, None)];
        assert_eq!((ended(&missed, false), ended(&missed, true)), (0, 1));
        let failed = [entry(1, None), entry(4, Some("no node"))];
        assert_eq!((ended(&failed, false), ended(&failed, true)), (4, 1));
    }

    #[test]
    fn every_bench_is_in_the_plan_once() {
        use clap::ValueEnum as _;
        let names: Vec<BenchName> = PLAN.iter().map(|(name, ..)| *name).collect();
        assert!(
            BenchName::value_variants().iter().all(|name| names.iter().filter(|other| *other == name).count() == 1)
        );
        for (name, word, _) in PLAN {
            assert_eq!(name.to_possible_value().expect("a value").get_name(), word);
        }
    }
}
