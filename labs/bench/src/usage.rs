//! This process's resource usage from /proc: resident memory and processor time.

use super::machine::{field, kibibytes};

/// Clock ticks a second in /proc, the same on every Linux that Rust runs on.
const TICKS: f64 = 100.0;
/// Resident bytes now; `None` if /proc does not say.
pub fn resident() -> Option<u64> {
    kibibytes(&field(&std::fs::read_to_string("/proc/self/status").ok()?, "VmRSS")?)
}

/// Resident bytes now that are not backed by a file; `None` if /proc does not show them.
pub fn anonymous() -> Option<u64> {
    kibibytes(&field(&std::fs::read_to_string("/proc/self/status").ok()?, "RssAnon")?)
}

/// Processor time of all threads so far, seconds; 0 if /proc does not tell.
pub fn processor_seconds() -> f64 {
    processor_seconds_of("self")
}

/// The same of another process, by its number.
pub fn processor_seconds_of(process: &str) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    // The command's name, in brackets, may contain anything.
    let fields = text.rsplit_once(')').map(|(_, rest)| rest).unwrap_or_default();
    let ticks = |index: usize| fields.split_whitespace().nth(index).and_then(|field| field.parse::<f64>().ok());
    (ticks(11).unwrap_or(0.0) + ticks(12).unwrap_or(0.0)) / TICKS
}

/// How many files this process may have open: the soft limit; `None` if there is none.
pub fn most_files() -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/limits").ok()?;
    text.lines().find_map(|line| line.strip_prefix("Max open files"))?.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_uses_something() {
        assert!(resident() > Some(1 << 20), "{:?}", resident());
        assert!(anonymous() > Some(1 << 16) && anonymous() < resident(), "{:?}", anonymous());
        let before = processor_seconds();
        let mut sum = 0u64;
        while processor_seconds() < before + 0.02 {
            sum = sum.wrapping_mul(31).wrapping_add(1);
        }
        assert!(processor_seconds() > before && sum > 0);
    }
}
