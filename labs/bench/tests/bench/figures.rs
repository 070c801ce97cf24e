//! What the benches measure, in small counts.

use serde_json::Value;

use crate::support::{Anvil, Bench, count, heavy, list, number, tell_skipped, text, wait_until};

const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";

/// The benches and the words that their plots must hold.
const PAGES: [(&str, &[&str]); 9] = [
    ("figure-11-consensus", &["embedded pow", "embedded poa", "success, %", "authors"]),
    ("figure-12-size", &["embedded poa", "prototype&apos;s way", "authors, per request", "8 KB"]),
    ("figure-16-sm4", &["Encryption, 1 KB", "Decryption, 8 KB", "frequency, %"]),
    ("figure-17-sm3", &["SM3 of 800 KB, authros", "frequency, %", "paper"]),
    ("sm2", &["SM2 on 32 bytes", "verify"]),
    ("record", &["SM4-GCM", "rest"]),
    ("gas", &["batch of 256", "prototype, 8 KB", "gas per record"]),
    ("gateway", &["records a second", "bound"]),
    ("pipeline", &["messages: time from capture", "pictures: busy stages"]),
];

/// What every bench writes.
fn expect_shape(bench: &Bench, name: &str) -> Vec<Value> {
    let report = bench.report(name);
    assert_eq!(text(&report, "name"), name);
    assert!(count(&report["machine"], "cores") > 0 && count(&report["machine"], "memory_bytes") > 0);
    assert!(!text(&report["machine"], "cpu").is_empty() && !list(&report, "notes").is_empty());
    let rows = list(&report, "results");
    for row in &rows {
        assert!(count(row, "bytes") > 0 && count(row, "runs") > 0 && !text(row, "unit").is_empty(), "{row}");
        let spread = ["min", "p50", "p95", "max"].map(|field| number(row, field));
        assert!(spread[0] > 0.0 && spread.is_sorted(), "{row}");
    }
    let csv = bench.result(name, "csv");
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines.len(), 1 + rows.len(), "{csv}");
    for column in ["bytes", "runs", "unit", "min", "p50", "p95", "max"] {
        assert!(lines[0].split(',').any(|found| found == column), "{column}: {}", lines[0]);
    }
    rows
}

/// A page is XML, and contains what it must.
fn expect_page(bench: &Bench, name: &str, words: &[&str]) {
    let page = bench.result(name, "svg");
    for word in words.iter().copied().chain(["</svg>", "cores"]) {
        assert!(page.contains(word), "no {word} in {name}.svg: {page}");
    }
    let script = "import sys, xml.dom.minidom as x; print(x.parse(sys.argv[1]).documentElement.tagName)";
    let path = bench.folder().join("authros-bench").join(format!("{name}.svg"));
    match std::process::Command::new("python3").args(["-c", script]).arg(path).output() {
        Ok(parsed) => assert_eq!(String::from_utf8_lossy(&parsed.stdout).trim(), "svg", "{parsed:?}"),
        Err(_) => tell_skipped("figures::expect_page (XML)", "no python3"),
    }
}

#[test]
fn all_repeats_the_papers_figures_in_one_command() {
    let _alone = heavy();
    let bench = Bench::new();
    let outcome = bench.run(&["all", "--quick"]).expect_code(0);
    assert!(outcome.stderr.contains("consensus (1 of 9)") && outcome.stderr.contains("pipeline (9 of 9)"), "{outcome}");
    let files = std::fs::read_dir(bench.folder().join("authros-bench")).expect("readable").count();
    assert_eq!(files, 3 * PAGES.len(), "three files for each bench");
    for (name, words) in PAGES {
        expect_shape(&bench, name);
        expect_page(&bench, name, words);
    }
    expect_uploaders(&bench, &["embedded poa each", "embedded poa batch", "embedded pow each", "embedded pow batch"]);
    expect_sizes(&bench, 24);
    expect_gas(&bench);
    expect_accepted(&bench);
    expect_steps(&bench);
    for load in list(&bench.report("pipeline"), "loads") {
        expect_verified(&load);
    }
}

/// Every upload of every run succeeded, and each run's figures are consistent.
fn expect_uploaders(bench: &Bench, expected: &[&str]) {
    let rows = expect_shape(bench, "figure-11-consensus");
    let name = |row: &Value| ["network", "consensus", "mode"].map(|field| text(row, field)).join(" ");
    for uploaders in [4, 6, 8] {
        let of = rows.iter().filter(|row| count(row, "uploaders") == uploaders);
        assert_eq!(of.map(name).collect::<Vec<_>>(), expected, "{uploaders}");
    }
    for row in &rows {
        let uploaders = count(row, "uploaders");
        assert_eq!((count(row, "succeeded"), count(row, "runs")), (uploaders, uploaders), "{row}");
        assert!((number(row, "success") - 100.0).abs() < 1e-9 && row["failures"] == serde_json::json!({}), "{row}");
        assert!(number(row, "max") <= number(row, "total") && number(row, "on_chain") <= number(row, "total"), "{row}");
        let transactions = count(row, "transactions");
        let expected = if row["mode"] == "each" { uploaders..=uploaders } else { 2..=4 };
        assert!(expected.contains(&transactions), "{row}");
        assert!(count(row, "blocks") >= 1 && count(row, "gas") > 30_000 * transactions, "{row}");
        let gas_limit = if row["network"] == "embedded" { 20_000_000 } else { 0xffff_ffff };
        assert_eq!(count(row, "gas_limit"), gas_limit, "{row}");
        let uploaders = number(row, "uploaders");
        match row["consensus"].as_str() {
            Some("poa") => {
                assert!((number(&row["paper"], "total_from") - 15.4 * uploaders).abs() < 1e-9, "{row}");
                assert_eq!(count(row, "period_set"), 25);
            }
            Some("pow") => {
                assert!((number(&row["paper"], "total_to") - 55.0 * uploaders).abs() < 1e-9, "{row}");
                assert_eq!(count(row, "difficulty"), 5000);
            }
            _ => assert!(row["paper"].is_null()),
        }
    }
}

fn expect_sizes(bench: &Bench, count_of_rows: usize) {
    let rows = expect_shape(bench, "figure-12-size");
    assert_eq!(rows.len(), count_of_rows);
    for row in &rows {
        let few = row["way"] == "prototype" && row["consensus"] == "pow";
        let uploads = if few { 1 } else { 4 };
        assert_eq!((count(row, "uploads"), count(row, "succeeded")), (uploads, uploads), "{row}");
        assert!((number(row, "success") - 100.0).abs() < 1e-9 && number(row, "uploads_per_second") > 0.0, "{row}");
        let (bytes, gas) = (number(row, "bytes"), number(row, "gas_per_upload"));
        let on_chain = bytes / 32.0 * 20_000.0;
        // Data on the chain costs by its length; a digest and a root do not.
        assert!(if row["way"] == "prototype" { gas > on_chain } else { gas < 120_000.0 }, "{row}");
        let transactions = if row["way"] == "batch" { 1..=uploads } else { uploads..=uploads };
        assert!(transactions.contains(&count(row, "transactions")), "{row}");
        let has_paper = row["network"] == "embedded" && count(row, "bytes") == 1024;
        assert_eq!(row["paper"].is_object(), has_paper, "{row}");
    }
}

fn expect_gas(bench: &Bench) {
    let rows = expect_shape(bench, "gas");
    let row = |way: &str, records: u32, bytes: u32| {
        let found = rows.iter().find(|row| {
            row["way"] == way && count(row, "records") == u64::from(records) && count(row, "bytes") == u64::from(bytes)
        });
        found.unwrap_or_else(|| panic!("no row {way} {records} {bytes}: {rows:?}"))
    };
    let each = number(row("each", 1, 1024), "min");
    assert!((40_000.0..120_000.0).contains(&each), "{each}");
    for records in [1, 16, 256, 4096] {
        let batch = row("batch", records, 1024);
        for field in ["first", "later_from", "later_to"] {
            assert!((30_000..=70_000).contains(&count(batch, field)), "{batch}");
        }
        assert!(number(batch, "max") * f64::from(records) <= 70_000.0, "{batch}");
    }
    assert!(each / number(row("batch", 256, 1024), "max") >= 150.0);
    // A stored word costs 20,000 gas, and 8 KB are 256 of them.
    for bytes in [1024, 2048, 4096, 8192] {
        assert!(number(row("prototype", 1, bytes), "min") > f64::from(bytes) / 32.0 * 20_000.0);
    }
    let targets = list(&bench.report("gas"), "targets");
    assert!(targets.len() == 2 && targets.iter().all(|one| one["ok"] == true), "{targets:?}");
}

/// The gateway kept every record that it was measured with.
fn expect_accepted(bench: &Bench) {
    let rows = expect_shape(bench, "gateway");
    for bytes in [1024, 58 * 1024] {
        let of_size: Vec<&Value> = rows.iter().filter(|row| count(row, "bytes") == bytes).collect();
        for way in ["sm3", "sm2 verify", "bound", "sm2 sign", "each", "window", "many"] {
            assert!(of_size.iter().any(|row| row["way"] == way), "no {way} of {bytes} bytes");
        }
        for row in of_size {
            let records = if bytes == 1024 { 64 } else { 8 };
            assert_eq!(count(row, "records"), records, "{row}");
            assert!(number(row, "mb_per_second") > 0.0 && number(row, "per_core") > 0.0, "{row}");
            let is_bound = row["kept"].is_null();
            assert!(is_bound == row["of_bound"].is_null() && is_bound == (count(row, "connections") == 0), "{row}");
        }
    }
    let idle = &bench.report("gateway")["idle"];
    assert_eq!((count(idle, "asked"), count(idle, "connections")), (20, 20), "{idle}");
    assert!(idle["limited_by"].is_null() && idle["resident"].is_u64(), "{idle}");
}

fn expect_steps(bench: &Bench) {
    let rows = expect_shape(bench, "record");
    for way in ["seal", "open"] {
        for bytes in [1024, 59_392, 1_000_000] {
            let of = |row: &&Value| row["way"] == way && count(row, "bytes") == bytes;
            let (wholes, steps): (Vec<_>, Vec<_>) = rows.iter().filter(of).partition(|row| row["step"] == "whole");
            assert_eq!(
                wholes.iter().map(|row| text(row, "by")).collect::<Vec<_>>(),
                ["authros", "rustcrypto", "libsm"]
            );
            assert!(wholes.iter().all(|row| number(row, "per_second") > 0.0 && number(row, "times") > 0.0));
            let shares: f64 = steps.iter().map(|row| number(row, "share")).sum();
            assert!((shares - 1.0).abs() < 1e-6 && steps.iter().any(|row| row["step"] == "SM2"), "{steps:?}");
        }
    }
}

/// Every message that was published was verified, and the law of conservation held.
fn expect_verified(load: &Value) {
    let published = count(load, "published");
    assert!(published >= 60, "{load}");
    for field in ["captured", "verified"] {
        assert_eq!(count(load, field), published, "{field}: {load}");
    }
    for field in ["lost_in_transport", "dropped", "tampered", "law_broken"] {
        assert_eq!(count(load, field), 0, "{field}: {load}");
    }
    assert!(number(load, "fsync_p50") > 0.0 && !list(load, "memory_by_minute").is_empty(), "{load}");
    assert!(count(load, "law_asked") >= 2 && count(load, "memory_most") > 1 << 20, "{load}");
    let busy = list(load, "stages");
    let seconds = |name: &str| {
        let found = busy.iter().find(|stage| stage["stage"] == name).unwrap_or_else(|| panic!("no {name}"));
        number(found, "seconds")
    };
    assert!(["seal", "commit", "anchor", "verify"].into_iter().all(|stage| seconds(stage) > 0.0), "{load}");
}

#[test]
fn what_is_published_is_verified_and_counted_beside_records_that_were_there() {
    let _alone = heavy();
    let bench = Bench::new();
    let arguments = ["pipeline", "--for", "2s", "--rate", "100", "--publishers", "2", "--before", "2000"];
    bench.run(&[&arguments[..], &["--load", "messages"]].concat()).expect_code(0);
    let rows = expect_shape(&bench, "pipeline");
    let loads = list(&bench.report("pipeline"), "loads");
    assert_eq!(loads.iter().map(|load| text(load, "load")).collect::<Vec<_>>(), ["messages"]);
    expect_verified(&loads[0]);
    // Those of before are another owner's, and in no count of this load.
    assert!(count(&loads[0], "before") == 2_000 && loads[0]["memory_slope"].is_null(), "{loads:?}");
    assert_eq!(rows.iter().map(|row| text(row, "milestone")).collect::<Vec<_>>(), ["durable", "confirmed", "verified"]);
    let published = count(&loads[0], "published");
    for row in rows {
        // Definitions are confirmed too, one for each topic.
        assert!((published..=published + 8).contains(&count(&row, "runs")), "{row}");
    }
}

#[test]
fn a_node_is_measured_without_the_embedded_networks() {
    let _alone = heavy();
    let place = "figures::a_node_is_measured_without_the_embedded_networks";
    let Some(node) = Anvil::start(&["--gas-limit", "4294967295", "--mixed-mining", "--block-time", "1"]) else {
        return tell_skipped(place, NO_NODE);
    };
    let (bench, url) = (Bench::new(), node.http());
    bench.run(&["consensus", "--uploaders", "4,6,8", "--node", &url]).expect_code(0);
    expect_uploaders(&bench, &["node dev each", "node dev batch"]);
    bench.run(&["size", "--runs", "4", "--node", &url]).expect_code(0);
    expect_sizes(&bench, 12);
}

#[test]
fn what_gas_promises_is_reached_on_every_machine() {
    let bench = Bench::new();
    let outcome = bench.run(&["gas", "--judge", "--out", "elsewhere/results"]).expect_code(0);
    assert!(outcome.stdout.contains("gas of a batch, at most 70000.000: yes"), "{outcome}");
    assert!(bench.folder().join("elsewhere/results/gas.csv").is_file());
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let bench = Bench::new();
    let refused = bench.run(&["consensus", "--uploaders", "0"]).expect_code(2);
    assert!(refused.stderr.contains("1..=10000") || refused.stderr.contains("1..10000"), "{refused}");
    bench.run(&["size", "--funder", "key"]).expect_code(2);
    let silent = "http://127.0.0.1:9";
    let refused = bench.run(&["consensus", "--uploaders", "1", "--node", silent]).expect_code(4);
    assert!(refused.stderr.contains("--node") && refused.stderr.contains("does not answer"), "{refused}");
    let file = bench.file("file", "", 0o600);
    let refused = bench.run(&["gas", "--out", &format!("{file}/results")]);
    assert!(refused.code.is_some_and(|code| code > 2) && refused.stderr.contains("--out"), "{refused}");
}

#[test]
fn a_signal_ends_a_bench_and_leaves_nothing() {
    let _alone = heavy();
    let bench = Bench::new();
    let running = bench.spawn(&["consensus", "--uploaders", "5000"]);
    wait_until(60, "uploads have begun", || {
        let folders = std::fs::read_dir(bench.scratch()).into_iter().flatten().flatten();
        let mut written = folders.map(|folder| folder.path().join("store/store.db-wal"));
        written.find(|file| file.metadata().is_ok_and(|about| about.len() > 100_000))
    });
    let outcome = running.stop("INT", 30).expect_code(8);
    assert!(outcome.stderr.contains("stopped before it finished") && outcome.stdout.is_empty(), "{outcome}");
    bench.expect_nothing_left();
}
