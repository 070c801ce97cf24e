//! Switches with a single purpose: to prove that the product notices faults and survives them.
//!
//! They exist only in the binary `authros-faulty`, built with the feature `fault`: `AUTHROS_FAULT` names a check to
//! switch off, `AUTHROS_FAIL_POINT` a place where the process ends as if killed, or where a task panics. In every other
//! build each check is always on, and a fail point does nothing.

/// The checks that can be named.
pub const CHECKS: [&str; 9] =
    ["digest", "signature", "commit", "tag", "anchor", "proof", "revoke", "restore", "authorise"];

/// The places in a record's life that can be named, in order: at each transition before it, between its parts, and
/// after it.
pub const POINTS: [&str; 24] = [
    "sealed",
    "vault-put",
    "appended",
    "commit-begun",
    "committed",
    "store-read",
    "store-put",
    "store-advanced",
    "batch-due",
    "batch-closed",
    "signed",
    "signed-kept",
    "handed-in",
    "events-read",
    "mined",
    "directory-kept",
    "walked",
    "confirmed",
    "read-back",
    "checked",
    "verified",
    "put-back",
    "block-due",
    "block-sealed",
];

/// Whether the check is switched off: never, in a build without the feature.
#[cfg(not(feature = "fault"))]
pub const fn is_off(_check: &str) -> bool {
    false
}

/// Whether the check is switched off by `AUTHROS_FAULT`.
#[cfg(feature = "fault")]
pub fn is_off(check: &str) -> bool {
    std::env::var("AUTHROS_FAULT").is_ok_and(|name| name == check)
}

/// A place where the process may be made to end: does nothing in a build without the feature.
#[cfg(not(feature = "fault"))]
pub const fn point(_place: &str) {}

/// Ends the process without any cleanup if `AUTHROS_FAIL_POINT` is `PLACE[:N]`, the N-th time it is reached, or panics
/// once with `panic:PLACE[:N]`.
#[cfg(feature = "fault")]
pub fn point(place: &str) {
    if let Some(how) = planned::due(place) {
        planned::strike(how, place);
    }
}

/// Never, in a build without the feature.
#[cfg(not(feature = "fault"))]
pub async fn task_fails(_task: &str) {
    std::future::pending().await
}

/// Panics half a second after a task began if `AUTHROS_FAIL_TASK` is `TASK[:N]` or `all[:N]`, in each of its first N
/// runs.
#[cfg(feature = "fault")]
pub async fn task_fails(task: &str) {
    if planned::task_is_due(task) {
        tokio::time::sleep(std::time::Duration::from_millis(500)).await;
        planned::strike(planned::How::Panic, task);
    }
    std::future::pending().await
}

#[cfg(feature = "fault")]
mod planned {
    use std::collections::HashMap;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{LazyLock, Mutex, PoisonError};

    /// What happens at a place.
    #[derive(Clone, Copy, PartialEq, Eq)]
    pub enum How {
        End,
        Panic,
    }

    struct Plan {
        how: How,
        place: String,
        at: u64,
        passed: AtomicU64,
    }

    static PLAN: LazyLock<Option<Plan>> = LazyLock::new(|| {
        let text = std::env::var("AUTHROS_FAIL_POINT").ok()?;
        let (how, text) = match text.strip_prefix("panic:") {
            Some(rest) => (How::Panic, rest.to_owned()),
            None => (How::End, text),
        };
        let (place, at) = numbered(&text);
        Some(Plan { how, place, at, passed: AtomicU64::new(0) })
    });

    static RUNS: Mutex<Option<HashMap<String, u64>>> = Mutex::new(None);

    fn numbered(text: &str) -> (String, u64) {
        match text.rsplit_once(':') {
            Some((name, number)) => (name.to_owned(), number.parse().unwrap_or(1)),
            None => (text.to_owned(), 1),
        }
    }

    pub fn due(place: &str) -> Option<How> {
        let plan = PLAN.as_ref().filter(|plan| plan.place == place)?;
        let passed = plan.passed.fetch_add(1, Ordering::AcqRel) + 1;
        (passed == plan.at).then_some(plan.how)
    }

    pub fn task_is_due(task: &str) -> bool {
        let Ok(text) = std::env::var("AUTHROS_FAIL_TASK") else { return false };
        let (name, times) = numbered(&text);
        if name != "all" && name != task {
            return false;
        }
        let mut runs = RUNS.lock().unwrap_or_else(PoisonError::into_inner);
        let run = runs.get_or_insert_default().entry(task.to_owned()).or_default();
        *run += 1;
        *run <= times
    }

    #[expect(clippy::panic, reason = "a panic is what was asked for")]
    pub fn strike(how: How, place: &str) {
        match how {
            // Like kill -9: no destructor, no flush, no message.
            How::End => std::process::abort(),
            How::Panic => std::panic::panic_any(format!("fail point {place}")),
        }
    }
}
