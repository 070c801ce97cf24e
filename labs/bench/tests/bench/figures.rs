//! `authros bench`: its documents have the promised shape, and its counts are right. No time is judged.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use serde_json::Value;
use support::{Anvil, Authros, Home, count, heavy, list, text};

const NO_NODE: &str = "no anvil; tests/run installs it into target/peers";
/// Allowance for a busy machine, seconds.
const LIMIT: u64 = 400;
const UPLOADERS: u64 = 20;

fn bare(home: &Home) -> Authros {
    Authros::bare(home.root()).with_variable("TMPDIR", home.root().to_str().expect("UTF-8"))
}

fn number(value: &Value, field: &str) -> f64 {
    value[field].as_f64().unwrap_or_else(|| panic!("no number '{field}' in {value}"))
}

/// What every bench prints, and that nothing is left behind.
fn expect_shape(report: &Value, name: &str, home: &Home) {
    assert_eq!(text(report, "name"), name);
    assert!(count(&report["machine"], "cores") > 0 && count(&report["machine"], "memory_bytes") > 0);
    assert!(!text(&report["machine"], "cpu").is_empty());
    for row in list(report, "results") {
        assert!(count(&row, "bytes") > 0 && count(&row, "runs") > 0 && !text(&row, "unit").is_empty(), "{row}");
        let spread = ["min", "p50", "p95", "max"].map(|field| number(&row, field));
        assert!(spread[0] > 0.0 && spread.is_sorted(), "{row}");
        assert!(row.as_object().expect("an object").contains_key("paper"), "{row}");
    }
    expect_nothing_left(home);
}

fn expect_nothing_left(home: &Home) {
    let left: Vec<_> = std::fs::read_dir(home.root()).expect("readable").flatten().map(|entry| entry.path()).collect();
    assert!(left.is_empty(), "left behind: {left:?}");
}

fn row<'a>(rows: &'a [Value], way: &str, records: u32, bytes: u32) -> &'a Value {
    let found = rows.iter().find(|row| {
        row["way"] == way && count(row, "records") == u64::from(records) && count(row, "bytes") == u64::from(bytes)
    });
    found.unwrap_or_else(|| panic!("no row {way} {records} {bytes}: {rows:?}"))
}

#[test]
fn gas_is_under_its_caps() {
    let home = Home::new();
    let report = bare(&home).json(&["bench", "gas"]);
    expect_shape(&report, "gas", &home);
    let rows = list(&report, "results");
    let each = number(row(&rows, "each", 1, 1024), "min");
    assert!((40_000.0..120_000.0).contains(&each), "{each}");
    for records in [1, 16, 256, 4096] {
        let batch = row(&rows, "batch", records, 1024);
        for field in ["first", "later_from", "later_to"] {
            assert!((30_000..=70_000).contains(&count(batch, field)), "{batch}");
        }
        assert!(number(batch, "max") * f64::from(records) <= 70_000.0, "{batch}");
    }
    assert!(each / number(row(&rows, "batch", 256, 1024), "max") >= 150.0);
    // A stored word costs 20,000 gas, and 8 KB are 256 of them.
    for bytes in [1024, 2048, 4096, 8192] {
        assert!(number(row(&rows, "prototype", 1, bytes), "min") > f64::from(bytes) / 32.0 * 20_000.0);
    }
    let acceptance = list(&report, "acceptance");
    assert!(acceptance.len() == 2 && acceptance.iter().all(|one| one["ok"] == true), "{acceptance:?}");
}

/// Every upload of every run succeeded, and each run's figures are consistent.
fn expect_all_uploaded(rows: &[Value]) {
    for row in rows {
        assert_eq!((count(row, "uploaders"), count(row, "succeeded")), (UPLOADERS, UPLOADERS), "{row}");
        assert!((number(row, "success") - 100.0).abs() < 1e-9 && count(row, "runs") == UPLOADERS, "{row}");
        assert!(number(row, "max") <= number(row, "total") && number(row, "on_chain") <= number(row, "total"), "{row}");
        let transactions = count(row, "transactions");
        let expected = if row["mode"] == "each" { UPLOADERS..=UPLOADERS } else { 2..=4 };
        assert!(expected.contains(&transactions), "{row}");
        assert!(count(row, "blocks") >= 1 && count(row, "gas") > 30_000 * transactions, "{row}");
        assert_eq!(row["failures"], serde_json::json!({}));
    }
}

#[test]
fn uploaders_succeed_on_every_network() {
    let _alone = heavy();
    let home = Home::new();
    let node = Anvil::start(&["--gas-limit", "4294967295"]);
    let uploaders = UPLOADERS.to_string();
    let mut arguments = vec!["bench", "consensus", "--uploaders", &uploaders, "--difficulty", "5000"];
    let url = node.as_ref().map(Anvil::http);
    arguments.extend(url.iter().flat_map(|url| ["--node", url.as_str()]));
    let report = bare(&home).json_within(LIMIT, &arguments);
    expect_shape(&report, "consensus", &home);
    let rows = list(&report, "results");
    expect_all_uploaded(&rows);
    let mut expected = vec!["embedded poa each", "embedded poa batch", "embedded pow each", "embedded pow batch"];
    if node.is_some() {
        expected.extend(["node dev each", "node dev batch"]);
    } else {
        support::tell_skipped("bench::uploaders_succeed_on_every_network (node)", NO_NODE);
    }
    let name = |row: &Value| ["network", "consensus", "mode"].map(|field| text(row, field)).join(" ");
    assert_eq!(rows.iter().map(name).collect::<Vec<_>>(), expected);
    for row in &rows {
        let gas_limit = if row["network"] == "embedded" { 20_000_000 } else { 0xffff_ffff };
        assert_eq!(count(row, "gas_limit"), gas_limit, "{row}");
        match row["consensus"].as_str() {
            Some("poa") => assert_eq!((number(&row["paper"], "total_from"), count(row, "period_set")), (308.0, 25)),
            Some("pow") => {
                assert_eq!((number(&row["paper"], "total_to"), count(row, "difficulty")), (1100.0, 5000))
            }
            _ => assert!(row["paper"].is_null()),
        }
    }
}

/// Every page is XML, and contains what it must.
fn expect_pages(directory: &Home, names: &[&str], words: &[&str]) {
    let script = "import sys, xml.dom.minidom as x; print(x.parse(sys.argv[1]).documentElement.tagName)";
    for name in names {
        let path = directory.root().join(format!("{name}.svg"));
        let page = std::fs::read_to_string(&path).expect("a page");
        for word in words.iter().copied().chain(["</svg>", "cores"]) {
            assert!(page.contains(word), "no {word} in {name}: {page}");
        }
        match std::process::Command::new("python3").args(["-c", script]).arg(&path).output() {
            Ok(parsed) => assert_eq!(String::from_utf8_lossy(&parsed.stdout).trim(), "svg", "{parsed:?}"),
            Err(_) => support::tell_skipped("bench::expect_pages (XML)", "no python3"),
        }
    }
    let files = std::fs::read_dir(directory.root()).expect("readable").count();
    assert_eq!(files, names.len(), "one file for each bench");
}

#[test]
fn messages_of_all_sizes_are_uploaded_both_ways() {
    let _alone = heavy();
    let (home, plots) = (Home::new(), Home::new());
    let node = Anvil::start(&["--gas-limit", "4294967295"]);
    let directory = plots.root().to_str().expect("UTF-8");
    let mut arguments = vec!["bench", "size", "--runs", "4", "--networks", "poa", "--svg", directory];
    let url = node.as_ref().map(Anvil::http);
    arguments.extend(url.iter().flat_map(|url| ["--node", url.as_str()]));
    if node.is_none() {
        support::tell_skipped("bench::messages_of_all_sizes_are_uploaded_both_ways (node)", NO_NODE);
    }
    let report = bare(&home).json_within(LIMIT, &arguments);
    expect_shape(&report, "size", &home);
    let rows = list(&report, "results");
    assert_eq!(rows.len(), if node.is_some() { 24 } else { 12 });
    for row in &rows {
        assert_eq!((count(row, "uploads"), count(row, "succeeded")), (4, 4), "{row}");
        assert!((number(row, "success") - 100.0).abs() < 1e-9 && number(row, "uploads_per_second") > 0.0, "{row}");
        let (bytes, gas) = (number(row, "bytes"), number(row, "gas_per_upload"));
        let on_chain = bytes / 32.0 * 20_000.0;
        // Data on the chain costs by its length; a digest and a root do not.
        assert!(if row["way"] == "prototype" { gas > on_chain } else { gas < 120_000.0 }, "{row}");
        let transactions = if row["mode"] == "each" { 4..=4 } else { 1..=4 };
        assert!(transactions.contains(&count(row, "transactions")), "{row}");
        let has_paper = row["consensus"] == "poa" && count(row, "bytes") == 1024;
        assert_eq!(row["paper"].is_object(), has_paper, "{row}");
    }
    expect_pages(&plots, &["size"], &["embedded poa", "prototype&#39;s way", "authors, per request", "8 KB"]);
}

#[test]
fn a_set_of_benches_gives_one_set_of_figures() {
    let (home, plots) = (Home::new(), Home::new());
    let directory = plots.root().to_str().expect("UTF-8");
    let plan = bare(&home).json(&["bench", "all", "--plan", "--skip", "sm2"]);
    let named: Vec<String> = list(&plan, "results").iter().map(|row| text(row, "bench")).collect();
    for name in [
        "sm3",
        "sm4",
        "record",
        "gas",
        "consensus",
        "size",
        "gateway",
        "pipeline",
        "memory",
        "pictures",
        "growth",
        "evidence",
    ] {
        assert!(named.iter().any(|found| found == name), "{name}: {named:?}");
    }
    assert!(!named.iter().any(|found| found == "sm2"), "{named:?}");
    bare(&home).run(&["bench", "all", "--skip", "nothing"]).expect_code(2);
    let others = "sm2,sm3,sm4,record,consensus,size,gateway,pipeline,memory,pictures,growth,evidence";
    let report = bare(&home).json_within(LIMIT, &["bench", "all", "--skip", others, "--svg", directory]);
    expect_shape(&report, "all", &home);
    let rows = list(&report, "results");
    assert!(rows.len() == 9 && rows.iter().all(|row| row["bench"] == "gas"), "{rows:?}");
    assert_eq!((text(&report["benches"][0], "name"), count(&report["ran"][0], "code")), ("gas".to_owned(), 0));
    expect_pages(&plots, &["gas"], &["batch", "prototype", "gas per record"]);
}

#[test]
fn a_gateway_keeps_every_record_it_is_measured_with() {
    let _alone = heavy();
    let home = Home::new();
    let report = bare(&home).json_within(LIMIT, &["bench", "gateway", "--records", "64", "--idle", "20"]);
    expect_shape(&report, "gateway", &home);
    let rows = list(&report, "results");
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
    let idle = &report["idle"];
    assert_eq!((count(idle, "asked"), count(idle, "connections")), (20, 20), "{idle}");
    assert!(idle["limited_by"].is_null() && idle["resident"].is_u64(), "{idle}");
}

#[test]
fn a_fleet_loses_nothing_while_a_gateway_is_stopped_and_begun_again() {
    let _alone = heavy();
    let home = Home::new();
    let size = ["--robots", "6", "--gateways", "2", "--records", "24", "--size", "200", "--failures", "1"];
    let report = bare(&home).json_within(LIMIT, &[&["bench", "fleet"][..], &size].concat());
    expect_shape(&report, "fleet", &home);
    let rows = list(&report, "results");
    let of = |row: &Value| {
        let copies = format!("{:.2}", number(row, "copies"));
        format!("{} {} {copies} {}", text(row, "part"), count(row, "gateways"), count(row, "records"))
    };
    let expected = ["one 1 1.00 24", "apart 2 1.00 24", "reconciling 2 2.00 24", "failures 2 2.00 24"];
    assert_eq!(rows.iter().map(of).collect::<Vec<_>>(), expected);
    for row in &rows {
        let bad = ["lost", "lacking", "doubled", "left"].map(|field| count(row, field));
        assert!(bad == [0; 4] && row["settled"] == true && number(row, "processor") > 0.0, "{row}");
    }
    // A record crosses once, with its header of 220 bytes; gateways that do not know each other say nothing.
    assert!(rows[..2].iter().all(|row| number(row, "between") < 1e-9), "{rows:?}");
    assert!(rows[2..].iter().all(|row| number(row, "between") > 420.0), "{rows:?}");
    assert_eq!((count(&rows[3], "failures"), count(&rows[2], "failures")), (1, 0));
}

#[test]
fn memory_is_told_for_each_of_many() {
    let _alone = heavy();
    let home = Home::new();
    let arguments = ["bench", "memory", "--idle-robots", "20", "--topics", "20", "--records", "10000"];
    let report = bare(&home).json_within(LIMIT, &arguments);
    assert_eq!(text(&report, "name"), "memory");
    let rows = list(&report, "results");
    let counted: Vec<(String, u64)> = rows.iter().map(|row| (text(row, "what"), count(row, "count"))).collect();
    let expected = [
        ("idle robot at a gateway", 20),
        ("watched topic", 20),
        ("watched topic, published", 64),
        ("record in the ledger", 10_000),
    ];
    assert_eq!(counted, expected.map(|(what, count)| (what.to_owned(), count)));
    // An end of a connection has a socket's buffers and a thread or task; a robot has both ends here.
    assert!(number(&rows[0], "bytes_each") > 1_000.0 && number(&rows[2], "bytes_each") > 1_000.0, "{rows:?}");
    assert!(rows.iter().all(|row| row["bytes_each"].is_f64()), "{rows:?}");
    expect_nothing_left(&home);
}

#[test]
fn what_cannot_be_measured_is_told() {
    let home = Home::new();
    let silent = format!("http://127.0.0.1:{}", support::free_port());
    bare(&home).fails(2, &["bench", "--csv", "gas"]);
    let told = bare(&home).with(&["--json"]).run(&["bench", "consensus", "--uploaders", "0"]).expect_code(2);
    assert!(told.stderr.contains("1..=10000") || told.stderr.contains("1..10000"), "{told}");
    // The node is queried first: nobody waits for two networks to learn that the third is not there.
    let message = bare(&home).fails(4, &["bench", "consensus", "--uploaders", "1", "--node", &silent]);
    assert!(message.contains("--node") && message.contains("does not answer"), "{message}");
    expect_nothing_left(&home);
}

#[test]
fn figures_come_as_comma_separated_lines_too() {
    let home = Home::new();
    // What is promised of gas does not depend on the machine, so it is reached wherever this is judged.
    let outcome = bare(&home).run(&["bench", "gas", "--csv", "--judge"]).expect_code(0);
    let lines: Vec<&str> = outcome.stdout.lines().collect();
    assert_eq!(lines.len(), 1 + 9, "{outcome}");
    let columns = lines[0].split(',').count();
    assert!(lines.iter().all(|line| line.split(',').count() == columns), "{outcome}");
    for name in ["way", "records", "min", "p50", "p95", "max", "paper"] {
        assert!(lines[0].split(',').any(|column| column == name), "{name}: {}", lines[0]);
    }
}

#[test]
fn a_record_is_measured_step_by_step() {
    let home = Home::new();
    let report = bare(&home).json(&["bench", "record", "--runs", "3"]);
    let rows = list(&report, "results");
    for way in ["seal", "open"] {
        for bytes in [1024, 59_392, 1_000_000] {
            let of = |row: &&Value| row["way"] == way && count(row, "bytes") == bytes;
            let (whole, steps): (Vec<_>, Vec<_>) = rows.iter().filter(of).partition(|row| row["step"] == "whole");
            assert!(whole.len() == 1 && number(whole[0], "per_second") > 0.0, "{way} {bytes}: {whole:?}");
            let shares: f64 = steps.iter().map(|row| number(row, "share")).sum();
            assert!((shares - 1.0).abs() < 1e-6 && steps.iter().any(|row| row["step"] == "SM2"), "{steps:?}");
        }
    }
    expect_nothing_left(&home);
    assert!(bare(&home).run(&["bench", "record", "--runs", "1"]).expect_code(0).stdout.contains("messages/s"));
}

#[test]
fn a_signal_ends_a_bench_and_leaves_nothing() {
    let _alone = heavy();
    let home = Home::new();
    let running = bare(&home).spawn(&["bench", "consensus", "--uploaders", "5000"]);
    support::wait_until(60, "uploads have begun", || {
        let mut files = support::authros::files_below(home.root()).into_iter();
        files.find(|file| {
            file.ends_with("vault/vault.db-wal") && file.metadata().is_ok_and(|about| about.len() > 100_000)
        })
    });
    let outcome = running.stop("INT", 30);
    assert_eq!(outcome.code, Some(8), "{outcome}");
    assert!(outcome.stderr.contains("stopped before it finished") && outcome.stdout.is_empty(), "{outcome}");
    expect_nothing_left(&home);
}

#[test]
fn what_is_published_is_verified_and_counted() {
    let _alone = heavy();
    let home = Home::new();
    let arguments = ["bench", "pipeline", "--for", "2s", "--rate", "100", "--publishers", "2", "--before", "2000"];
    let report = bare(&home).json_within(LIMIT, &arguments);
    expect_shape(&report, "pipeline", &home);
    let rows = list(&report, "results");
    let loads = list(&report, "loads");
    assert_eq!(loads.iter().map(|load| text(load, "load")).collect::<Vec<_>>(), ["messages", "pictures"]);
    for load in &loads {
        let published = count(load, "published");
        assert!(published >= 60, "{load}");
        for field in ["captured", "verified"] {
            assert_eq!(count(load, field), published, "{field}: {load}");
        }
        for field in ["lost_in_transport", "dropped", "tampered", "law_broken"] {
            assert_eq!(count(load, field), 0, "{field}: {load}");
        }
        // Those of before are another owner's, and in no count of this load.
        assert!(count(load, "before") == 2_000 && number(load, "fsync_p50") > 0.0, "{load}");
        assert!(!list(load, "memory_by_minute").is_empty() && load["memory_slope"].is_null(), "{load}");
        assert!(count(load, "law_asked") >= 2 && count(load, "memory_most") > 1 << 20, "{load}");
        let of_load = || rows.iter().filter(|row| row["load"] == load["load"]);
        assert_eq!(
            of_load().map(|row| text(row, "milestone")).collect::<Vec<_>>(),
            ["durable", "confirmed", "verified"]
        );
        for row in of_load() {
            // Definitions are confirmed too, one for each topic.
            assert!((published..=published + 8).contains(&count(row, "runs")), "{row}");
        }
        let busy = list(load, "stages");
        let seconds = |name: &str| {
            let found = busy.iter().find(|stage| stage["stage"] == name).unwrap_or_else(|| panic!("no {name}"));
            number(found, "seconds")
        };
        assert!(["seal", "commit", "anchor", "verify"].into_iter().all(|stage| seconds(stage) > 0.0), "{load}");
    }
}

#[test]
fn bundles_are_measured_and_each_one_holds() {
    let (home, plots) = (Home::new(), Home::new());
    let directory = plots.root().to_str().expect("UTF-8");
    let sizes = ["--records", "300", "--batches", "20", "--signers", "12", "--runs", "1", "--svg", directory];
    let report = bare(&home).json_within(LIMIT, &[&["bench", "evidence"][..], &sizes].concat());
    expect_shape(&report, "evidence", &home);
    let rows = list(&report, "results");
    let of = |what: &str, records: u64| {
        let found = rows.iter().find(|row| row["what"] == what && count(row, "records") == records);
        found.unwrap_or_else(|| panic!("no {what} of {records}: {rows:?}"))
    };
    for (records, batches) in [(1, 1), (100, 1), (300, 2)] {
        let row = of("bundle", records);
        assert_eq!((count(row, "batches"), count(row, "signers")), (batches, 1), "{row}");
        // What is sealed is longer than its message of 1 KiB.
        assert!(number(row, "min") > 1024.0 && count(row, "nodes_bytes") > 0, "{row}");
    }
    assert!(number(of("bundle", 1), "min") > number(of("bundle", 100), "min"), "what all share counts once");
    let hour = of("hour", 20);
    assert!(count(hour, "total_bytes") > count(hour, "nodes_bytes") && count(hour, "batches") == 20, "{hour}");
    assert_eq!((count(of("signers", 12), "signers"), count(of("prove", 12), "batches")), (12, 1));
    for what in ["reference", "read", "check", "verify"] {
        assert!(number(of(what, 300), "of_reference") > 0.0 && number(of(what, 12), "of_reference") > 0.0);
    }
    assert_eq!(list(&report, "acceptance").len(), 1);
    expect_pages(&plots, &["evidence"], &["Verification, beside SM2 and SM3 alone", "Proof bytes per batch"]);
}
