//! `authros-bench all`: every bench, one after the other.

use std::time::Instant;

use super::args::{
    AllArguments, Bench, ConsensusArguments, GatewayArguments, LoadChoice, NetworkArguments, NetworkChoice,
    PipelineArguments, RunsArguments, SizeArguments,
};
use super::{Lab, measure};
use authros_model::Consensus;
use authros_output::table;
use authros_service::Failure;

/// How much is measured.
struct Counts {
    runs: u32,
    uploaders: [u32; 3],
    uploads: u32,
    difficulty: u64,
    records: u32,
    idle: u32,
    length: &'static str,
    rate: u32,
}

/// As in the paper, where it says so.
const FULL: Counts = Counts {
    runs: 300,
    uploaders: [300, 500, 700],
    uploads: 300,
    difficulty: Consensus::PAPER_DIFFICULTY,
    records: 1024,
    idle: 200,
    length: "10s",
    rate: 1000,
};
const QUICK: Counts = Counts {
    runs: 3,
    uploaders: [4, 6, 8],
    uploads: 4,
    difficulty: 5_000,
    records: 64,
    idle: 20,
    length: "1s",
    rate: 100,
};

/// The outcome of one bench.
struct Entry {
    bench: &'static str,
    seconds: f64,
    /// The exit code as if it had run alone with `--judge`.
    code: u8,
    /// Why it could not be measured.
    error: Option<String>,
}

/// Runs them; the exit code is the first one that is not 0, of those that failed or, if figures are judged, of all.
///
/// # Errors
/// None of its own: a bench's error is reported, and the next one begins.
pub async fn run(lab: &Lab, arguments: &AllArguments, judge: bool) -> Result<u8, Failure> {
    let plan = plan(arguments);
    let mut entries = Vec::new();
    for (turn, (name, bench)) in plan.iter().enumerate() {
        lab.outlet.note(&format!("{name} ({} of {})", turn + 1, plan.len()));
        let begun = Instant::now();
        let (code, error) = match measure(lab, bench).await {
            Ok(judgement) => (judgement.exit_code(), None),
            Err(failure) => (failure.kind.exit_code(), Some(failure.message)),
        };
        if let Some(error) = &error {
            lab.outlet.note(&format!("authros-bench: {name}: {error}"));
        }
        entries.push(Entry { bench: name, seconds: begun.elapsed().as_secs_f64(), code, error });
    }
    lab.outlet.tell(&text(&entries));
    Ok(ended(&entries, judge))
}

/// How many uploads of each size `size` makes.
pub fn uploads(arguments: &AllArguments) -> u32 {
    if arguments.quick { QUICK.uploads } else { FULL.uploads }
}

/// Every bench with its arguments. A node is measured without the embedded networks, so what needs these is left out.
fn plan(arguments: &AllArguments) -> Vec<(&'static str, Bench)> {
    let counts = if arguments.quick { QUICK } else { FULL };
    let runs = || RunsArguments { runs: counts.runs };
    let network = NetworkArguments {
        networks: vec![NetworkChoice::Poa, NetworkChoice::Pow],
        period: NetworkArguments::PERIOD,
        difficulty: counts.difficulty,
        node: arguments.node.clone(),
    };
    let pipeline = PipelineArguments {
        length: counts.length.to_owned(),
        load: LoadChoice::Both,
        rate: counts.rate,
        bytes: 1024,
        before: 0,
        publishers: 4,
    };
    let uploaders = counts.uploaders.to_vec();
    let mut plan = vec![
        ("consensus", Bench::Consensus(ConsensusArguments { uploaders, network: network.clone() })),
        ("size", Bench::Size(SizeArguments { runs: counts.uploads, network })),
        ("sm4", Bench::Sm4(runs())),
        ("sm3", Bench::Sm3(runs())),
        ("sm2", Bench::Sm2(runs())),
        ("record", Bench::Record(runs())),
        ("gateway", Bench::Gateway(GatewayArguments { records: counts.records, idle: counts.idle })),
    ];
    if arguments.node.node.is_none() {
        plan.extend([("gas", Bench::Gas), ("pipeline", Bench::Pipeline(pipeline))]);
    }
    plan
}

fn ended(entries: &[Entry], judge: bool) -> u8 {
    let counted = entries.iter().filter(|entry| judge || entry.error.is_some());
    counted.map(|entry| entry.code).find(|code| *code != 0).unwrap_or(0)
}

fn text(entries: &[Entry]) -> String {
    let row = |entry: &Entry| {
        let verdict = match (&entry.error, entry.code) {
            (Some(error), code) => format!("{code}: {error}"),
            (None, 0) => "ok".to_owned(),
            (None, 8) => "8: uploads failed, or messages were lost".to_owned(),
            (None, code) => format!("{code}: a target was missed"),
        };
        vec![entry.bench.to_owned(), format!("{:.0}", entry.seconds), verdict]
    };
    let rows: Vec<Vec<String>> = entries.iter().map(row).collect();
    format!("\n{}", table(&["bench", "seconds", "verdict"], &rows))
}

#[cfg(test)]
mod tests {
    use super::super::args::NodeArguments;
    use super::*;

    #[test]
    fn a_bench_that_failed_sets_the_exit_code_and_a_missed_target_only_where_it_is_judged() {
        let entry =
            |code, error: Option<&str>| Entry { bench: "a", seconds: 1.0, code, error: error.map(ToOwned::to_owned) };
        let missed = [entry(0, None), entry(1, None), entry(8, None)];
        assert_eq!((ended(&missed, false), ended(&missed, true)), (0, 1));
        let failed = [entry(1, None), entry(4, Some("no node"))];
        assert_eq!((ended(&failed, false), ended(&failed, true)), (4, 1));
    }

    #[test]
    fn the_full_form_has_the_papers_loads_and_a_node_replaces_the_embedded_networks() {
        let of = |node: Option<&str>| {
            let node = NodeArguments { node: node.map(ToOwned::to_owned), funder: None };
            plan(&AllArguments { quick: false, node })
        };
        let (alone, on_node) = (of(None), of(Some("http://127.0.0.1:8545")));
        assert_eq!((alone.len(), on_node.len()), (9, 7));
        for (plan, networks) in [(&alone, 2), (&on_node, 1)] {
            let Bench::Consensus(consensus) = &plan[0].1 else { panic!("figure 11") };
            assert_eq!((&consensus.uploaders[..], consensus.network.places().len()), (&[300, 500, 700][..], networks));
            let Bench::Size(size) = &plan[1].1 else { panic!("figure 12") };
            assert_eq!((size.runs, size.network.difficulty), (300, 0x4c_ccc8));
        }
    }
}
