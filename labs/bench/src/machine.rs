//! The machine that a figure was measured on, according to /proc.

use serde::Serialize;

use authros_model::clean;

/// Longest text taken from /proc, characters.
const LONGEST: usize = 80;

/// What figures depend on most.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// The processor's name.
    pub cpu: String,
    /// Hardware threads that this process may use.
    pub cores: usize,
    /// Main memory, bytes; 0 if unknown.
    pub memory_bytes: u64,
    /// The operating system.
    pub system: String,
    /// This program's version.
    pub authros: &'static str,
}

impl Machine {
    /// This machine.
    pub fn read() -> Self {
        let text = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let release = clean(text("/proc/sys/kernel/osrelease").trim(), LONGEST);
        Self {
            cpu: field(&text("/proc/cpuinfo"), "model name").unwrap_or_else(|| "unknown".to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_bytes: field(&text("/proc/meminfo"), "MemTotal").and_then(|found| kibibytes(&found)).unwrap_or(0),
            system: format!("{} {release}", std::env::consts::OS).trim().to_owned(),
            authros: env!("CARGO_PKG_VERSION"),
        }
    }

    /// In one line.
    pub fn line(&self) -> String {
        let tenths = self.memory_bytes * 10 / (1 << 30);
        let memory = format!("{}.{} GiB", tenths / 10, tenths % 10);
        format!("{}, {} cores, {memory} memory, {}, authros {}", self.cpu, self.cores, self.system, self.authros)
    }
}

/// The value of the first line `name : value`.
pub(super) fn field(text: &str, name: &str) -> Option<String> {
    let mut pairs = text.lines().filter_map(|line| line.split_once(':'));
    pairs.find(|(found, _)| found.trim() == name).map(|(_, value)| clean(value.trim(), LONGEST))
}

/// `16384 kB`, in bytes.
pub(super) fn kibibytes(text: &str) -> Option<u64> {
    let number: u64 = text.split_whitespace().next()?.parse().ok()?;
    number.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found() {
        let text = "processor\t: 0\nmodel name\t: Some\u{1b}[31m CPU\nmodel name\t: other\nMemTotal:   2048 kB\n";
        assert!(field(text, "model name").expect("found").starts_with("Some"));
        assert!(!field(text, "model name").expect("found").contains('\u{1b}'));
        assert_eq!(field(text, "MemTotal").and_then(|found| kibibytes(&found)), Some(2048 * 1024));
        assert_eq!(field(text, "absent"), None);
        assert!(Machine::read().cores > 0 && !Machine::read().line().is_empty());
    }
}
