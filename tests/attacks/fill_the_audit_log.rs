//! To fill the disk through the log that can never be shortened: an account without any right keeps requesting
//! another's records, and each request costs its keeper a durable line.

use authros::gateway::{Code, Feed};

use super::parts::Parts;
use super::support::gate::Gate;
use super::support::list;
use super::support::member::{Member, connect};
use super::{Outcome, judge};

const QUESTIONS: usize = 200;

#[tokio::test(flavor = "multi_thread")]
async fn questions_that_are_refused_leave_a_line_each() {
    let gate = Gate::new();
    gate.home.profile("alice").enrol();
    let bob = gate.home.profile("bob");
    bob.enrol();
    let alice = Member::of(&gate.home, "alice", gate.gateway.domain);
    let reader = Member::of(&gate.home, "bob", gate.gateway.domain);
    let credentials = reader.allocate(&gate.gateway, "bob").await.expect("allocates");
    let mut session = connect(&gate.gateway, &credentials).await;
    let mut parts = Parts::default();
    for _ in 0..QUESTIONS {
        let page = session
            .feed(&Feed::of(alice.address()))
            .await
            .map(|page| format!("a list of {} records", page.entries.len()));
        parts.answered("Feed", page, &[Code::NotAuthorised]);
    }
    let lines = list(&bob.json(&["audit", "list", "--limit", "1000"]), "audit");
    let lines = lines.iter().filter(|line| line["action"] == "query").count();
    if lines > 1 {
        parts.reached(format!("{QUESTIONS} refused questions left {lines} durable lines"));
    }
    let outcome = match parts.outcome() {
        Outcome::Refused(refusal) => Outcome::Refused(format!("{refusal}; {lines} lines for {QUESTIONS} questions")),
        other => other,
    };
    judge("fill_the_audit_log", outcome);
}
