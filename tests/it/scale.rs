//! The table of docs/gateway.md is what its script prints.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use std::path::Path;

use crate::support::{process::output_of, skipped, system_program};

#[test]
fn the_table_of_the_page_is_the_scripts_output() {
    let Some(python) = system_program("python3") else { skipped!("no python3") };
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (python, script) = (python.display().to_string(), root.join("tools/scale.py").display().to_string());
    let printed = output_of(&python, &[&script]);
    let page = std::fs::read_to_string(root.join("docs/gateway.md")).expect("the page");
    let (_, behind) = page.split_once("<!-- scale -->\n").expect("where the table begins");
    let (table, _) = behind.split_once("<!-- /scale -->").expect("where it ends");
    assert!(table == printed, "run tools/scale.py and put this into docs/gateway.md:\n{printed}");
    assert_eq!(printed.lines().filter(|line| line.starts_with('|')).count(), 9, "all rows");

    // By hand: 400 robots with 10 messages of 1,024 bytes a second; 1,444 bytes a record, one batch a second.
    let one = output_of(&python, &[&script, "400", "10", "1024"]);
    let cells: Vec<&str> = one.lines().last().expect("a row").split('|').map(str::trim).collect();
    assert_eq!((cells[4], cells[5], cells[6], cells[7]), ("4,000", "1", "499", "86,400"), "{one}");
}
