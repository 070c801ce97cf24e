//! The terminal's size, also where it reports none: over a serial line, or in a shell within an editor, it is 0 by 0, which
//! means that it is not known and not that it is small.

use std::io;

/// What such a terminal is taken for where LINES and COLUMNS do not say better.
const USUAL: (u16, u16) = (80, 24);
/// The largest that a variable may say.
const LARGEST: u16 = 1000;

/// What to do so that it is known.
pub const ADVICE: &str = "the terminal reports no size: stty rows 24 cols 80";

/// Columns and rows, and whether the terminal reports them.
///
/// # Errors
/// If the terminal cannot be asked.
pub fn size() -> io::Result<((u16, u16), bool)> {
    let reported = crossterm::terminal::size()?;
    let known = known(reported, |name| std::env::var(name).ok());
    Ok((known, known == reported))
}

/// The size reported, or that of the environment, or the usual one.
pub fn known(reported: (u16, u16), variable: impl Fn(&str) -> Option<String>) -> (u16, u16) {
    if reported.0 > 0 && reported.1 > 0 {
        return reported;
    }
    let said = |name: &str| {
        let number = variable(name).and_then(|text| text.trim().parse::<u16>().ok());
        number.filter(|number| (1..=LARGEST).contains(number))
    };
    said("COLUMNS").zip(said("LINES")).unwrap_or(USUAL)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_size_is_not_a_small_one() {
        let of = |reported, columns: &'static str, lines: &'static str| {
            known(reported, |name| Some(if name == "LINES" { lines } else { columns }.to_owned()))
        };
        assert_eq!(known((0, 0), |_| None), USUAL);
        assert_eq!(of((0, 0), "100", "30"), (100, 30));
        assert_eq!(of((0, 24), "100", "30"), (100, 30), "half a size is none");
        assert_eq!(of((7, 3), "100", "30"), (7, 3), "a small one is reported");
        for (columns, lines) in
            [("0", "30"), ("100", ""), ("wide", "30"), ("65536", "30"), ("1001", "30"), ("-1", "-1")]
        {
            assert_eq!(of((0, 0), columns, lines), USUAL, "{columns} {lines}");
        }
    }
}
