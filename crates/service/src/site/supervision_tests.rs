//! Tasks that fail are restarted and shown; those that are no longer wanted are not.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use tokio::sync::Notify;

use crate::reply::{Event, TaskState};
use crate::site::testing::Ground;

#[derive(Default)]
struct Part {
    runs: AtomicUsize,
    closed: AtomicBool,
    again: Notify,
}

async fn fails_once(part: Arc<Part>) {
    assert!(part.runs.fetch_add(1, Ordering::AcqRel) > 0, "the first run fails");
    part.again.notify_one();
    std::future::pending::<()>().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_task_that_panics_is_told_shown_and_begun_again() {
    let ground = Ground::with(&[]);
    let (supervisor, part) = (&ground.parts.supervisor, Arc::new(Part::default()));
    let mut events = ground.parts.hub.events().subscribe();
    let task = supervisor.keep("news", &part, fails_once);
    let text = loop {
        if let Event::Notice { text, .. } = events.recv().await.expect("a notice") {
            break text;
        }
    };
    assert!(text.contains("'news'") && text.contains("the first run fails"), "{text}");
    part.again.notified().await;
    let views = supervisor.views();
    let view = views.first().expect("shown");
    assert_eq!((views.len(), view.name.as_str(), view.restarts, view.state), (1, "news", 1, TaskState::Running));
    task.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_task_that_is_not_wanted_any_more_is_not_begun_again() {
    let ground = Ground::with(&[]);
    let (supervisor, part) = (&ground.parts.supervisor, Arc::new(Part::default()));
    let wanted = |part: &Arc<Part>| !part.closed.load(Ordering::Acquire);
    let closes = |part: Arc<Part>| async move {
        part.runs.fetch_add(1, Ordering::AcqRel);
        part.closed.store(true, Ordering::Release);
    };
    supervisor.keep_while("once", &part, wanted, closes).await.expect("ends");
    assert_eq!((part.runs.load(Ordering::Acquire), supervisor.views().len()), (1, 0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_task_is_begun_again_once_the_site_was_told_to_end() {
    let ground = Ground::with(&[]);
    let (supervisor, part) = (&ground.parts.supervisor, Arc::new(Part::default()));
    ground.parts.life.end();
    supervisor.keep("late", &part, fails_once).await.expect("ends");
    assert_eq!(part.runs.load(Ordering::Acquire), 1);
}
