//! The example of this crate's page.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use crate as authros_ros;

use authros_ros::{Definition, Limits, RosError};

fn example() -> Result<(), RosError> {
    let text = Definition::parse("std_msgs/String", "string data")?;
    assert_eq!(text.md5sum(), "992ce8a1687cec8c8bd883ec73ca41d1");
    let value = text.decode(b"\x05\0\0\0hello", Limits::default())?;
    assert!(format!("{value:?}").contains("hello"));
    // A length that the message does not have is an error, not an allocation.
    assert!(text.decode(b"\xff\xff\xff\x7fhello", Limits::default()).is_err());
    Ok(())
}

#[test]
fn the_example_of_the_page_runs() {
    example().expect("it runs");
    // What the page shows is what ran here.
    let shown = include_str!("../README.md").split("```").nth(1).expect("an example");
    let here = include_str!("readme_tests.rs");
    for line in shown.lines().map(str::trim).filter(|line| !line.is_empty()) {
        assert!(here.contains(line), "{line}");
    }
}
