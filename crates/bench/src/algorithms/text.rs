//! The figures for people: a table, a histogram of the largest, the targets.

use super::{Acceptance, Row};
use crate::report::Report;
use crate::spread::histogram;
use authros_output::table;

pub(super) const NOTES: [&str; 7] = [
    "Times are microseconds per message; implementations take turns, run by run. Ratios use the shortest times, which \
     other work on the machine disturbs least.",
    "digest: SM3. seal, open: SM4-GCM with key set-up, 32 bytes of additional data and the tag. record: a whole record \
     with its keys, sealed head and body, SM3 and SM2 signature.",
    "authros: the chosen provider (SM4 by the kernel named above); authros-known: a signer seen before, whose table is \
     cached; authros-many: 16 messages side by side; crate: the crate sm2; crates: sm4, ctr and ghash; libsm: its SM4 \
     behind our GCM, as the program uses it; libsm-gcm: its own GCM. openssl: a context made for each message, as its \
     users do; its key is made once.",
    "authros-batch-N: one signature over the Merkle root of N records' leaves, with every record's path made or \
     checked; per record. A record signed this way cannot stand alone, so none is (ARCHITECTURE.md).",
    "outliers: values more than a quarter above the median, and the three largest.",
    "The paper gives 6.19 to 6.34 ms for SM3 of 800 KB (section V, figure 17). Of SM4 (figure 16) it gives no numbers.",
    "Judge only on an otherwise idle machine.",
];

pub(super) fn text(report: &Report<Row>, acceptance: &[Acceptance], other: &str) -> String {
    let head = ["work", "bytes", "by", "runs", "min", "p5", "p50", "p95", "max", "p5-p95", "outliers", "paper"];
    let rows: Vec<Vec<String>> = report.results.iter().map(cells).collect();
    let kernel = report.about.get("kernel").and_then(|kernel| kernel.as_str()).unwrap_or_default();
    let mut lines = vec![
        format!("{}, microseconds", report.name),
        format!("machine: {}", report.machine.line()),
        format!("SM4 kernel: {kernel}; {other}"),
        String::new(),
        table(&head, &rows),
    ];
    let largest = report.results.iter().map(|row| row.measured.bytes).max();
    for row in report.results.iter().filter(|row| row.by == "authros" && Some(row.measured.bytes) == largest) {
        lines.push(format!("\n{} of {} bytes by authros:", row.work, row.measured.bytes));
        lines.extend(histogram(&row.times, "us"));
    }
    if !acceptance.is_empty() {
        lines.push(String::new());
    }
    for one in acceptance {
        let answer = if one.ok { "yes" } else { "NO" };
        lines.push(format!("{} {:.3}: {answer} ({:.3})", one.what, one.limit, one.found));
    }
    lines.push(String::new());
    lines.extend(NOTES.map(str::to_owned));
    lines.join("\n")
}

fn cells(row: &Row) -> Vec<String> {
    let spread = row.measured.spread;
    let greatest: Vec<String> = row.outliers.iter().take(3).map(|time| format!("{time:.0}")).collect();
    let outliers = match row.outliers.len() {
        0 => "none".to_owned(),
        count => format!("{count} ({})", greatest.join(", ")),
    };
    let time = |value: f64| if value < 100.0 { format!("{value:.2}") } else { format!("{value:.1}") };
    vec![
        row.work.to_owned(),
        row.measured.bytes.to_string(),
        row.by.to_owned(),
        row.measured.runs.to_string(),
        time(spread.min),
        time(row.p5),
        time(spread.p50),
        time(spread.p95),
        time(spread.max),
        time(spread.p95 - row.p5),
        outliers,
        row.paper.map_or("-".to_owned(), |paper| format!("{paper:.0}")),
    ]
}
