//! Fault injection, to prove that the product notices faults and survives them.
//!
//! Only `authros-faulty`, which calls [`arm`], heeds the variables: `AUTHROS_FAULT` switches off a check,
//! `AUTHROS_FAIL_POINT` ends the process or a task at a place. A release build contains none of this.

use std::sync::atomic::{AtomicBool, Ordering};

static ARMED: AtomicBool = AtomicBool::new(false);

/// Lets this process heed the variables; no effect in a release build.
pub fn arm() {
    ARMED.store(true, Ordering::Release);
}

/// Constantly false in a release build, so the compiler drops what it guards.
fn is_armed() -> bool {
    cfg!(debug_assertions) && ARMED.load(Ordering::Acquire)
}

/// Whether the check is switched off by `AUTHROS_FAULT`.
pub fn is_off(check: &str) -> bool {
    is_armed() && std::env::var("AUTHROS_FAULT").is_ok_and(|name| name == check)
}

/// With `AUTHROS_FAIL_POINT` = `[panic:|stall:]PLACE[:N]`, aborts, panics or sleeps ten minutes the N-th time at PLACE.
pub fn point(place: &str) {
    if !is_armed() {
        return;
    }
    if let Some(how) = planned::due(place) {
        planned::strike(how, place);
    }
}

/// With `AUTHROS_FAIL_TASK` = `TASK[:N]` or `all[:N]`, panics after half a second in each of the first N runs; else
/// never ends.
pub async fn task_fails(task: &str) {
    if is_armed() && planned::task_is_due(task) {
        tokio::time::sleep(std::time::Duration::from_millis(500)).await;
        planned::strike(planned::How::Panic, task);
    }
    std::future::pending().await
}

mod planned {
    use std::collections::HashMap;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{LazyLock, Mutex, PoisonError};

    #[derive(Clone, Copy, PartialEq, Eq)]
    pub enum How {
        End,
        Panic,
        Stall,
    }

    struct Plan {
        how: How,
        place: String,
        at: u64,
        passed: AtomicU64,
    }

    static PLAN: LazyLock<Option<Plan>> = LazyLock::new(|| {
        let text = std::env::var("AUTHROS_FAIL_POINT").ok()?;
        let (how, text) = match (text.strip_prefix("panic:"), text.strip_prefix("stall:")) {
            (Some(rest), _) => (How::Panic, rest.to_owned()),
            (None, Some(rest)) => (How::Stall, rest.to_owned()),
            (None, None) => (How::End, text),
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
            How::Stall => std::thread::sleep(std::time::Duration::from_secs(600)),
            How::Panic => std::panic::panic_any(format!("fail point {place}")),
        }
    }
}
