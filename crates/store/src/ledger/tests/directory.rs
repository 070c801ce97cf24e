//! The contract's events in the ledger: the cost of each.

use super::*;
use crate::model::{Domain, Token};

/// A ledger that knows its contract.
fn bound() -> (tempfile::TempDir, Ledger) {
    let (home, ledger) = open();
    ledger.rights.bind_contract(Domain([4; 32]), "{}").expect("bound");
    (home, ledger)
}

fn event(block: u64, kind: RightKind, epoch: u64) -> RightEvent {
    let is_grant = kind == RightKind::Grant;
    RightEvent {
        block,
        place: 0,
        kind,
        owner: Some(Address([1; 20])),
        grantee: Some(Address([2; 20])),
        epoch: Some(epoch),
        token: (!is_grant).then_some(Token([3; 32])),
        event: format!("{block}"),
        envelope: is_grant.then(|| vec![5; 1_300]),
    }
}

#[test]
fn a_grant_and_its_revocation_cost_the_same_after_six_thousand_of_them() {
    let (_home, ledger) = bound();
    let changes = || ledger.database.write(|session| Ok(session.connection.total_changes())).expect("counted");
    ledger.rights.keep_rights(vec![event(1, RightKind::Epoch, 1)]).expect("kept");
    let mut costs = std::collections::BTreeSet::new();
    for hundred in 0..60u64 {
        let rounds = (1..=100).map(|round| hundred * 100 + round);
        let both = rounds.flat_map(|round| {
            [event(round * 2, RightKind::Grant, round), event(round * 2 + 1, RightKind::Epoch, round + 1)]
        });
        let before = changes();
        ledger.rights.keep_rights(both.collect()).expect("kept");
        costs.insert(changes() - before);
    }
    assert_eq!(costs.len(), 1, "{costs:?}");
    let standing = ledger.rights.standing_rights().expect("read");
    assert_eq!(standing.last, Some((12_001, 0)));
    let left: Vec<&str> = standing.events.iter().map(|event| event.event.as_str()).collect();
    assert_eq!(left, ["12001"], "the newest epoch alone");
    assert_eq!(ledger.rights.revoked_grants(Address([2; 20])).expect("history").len(), 6_000);
}

#[test]
fn a_ledger_belongs_to_one_contract_for_good() {
    let (_home, ledger) = bound();
    assert_eq!(ledger.rights.bind_contract(Domain([4; 32]), "{}"), Ok(()));
    let (bound, domain) = (Domain([4; 32]), Domain([5; 32]));
    assert_eq!(ledger.rights.bind_contract(domain, "{}"), Err(StoreError::Bound { bound, domain }));
    ledger.rights.forget_rights().expect("forgotten");
    assert!(ledger.rights.bind_contract(domain, "{}").is_err());
}

#[test]
fn what_an_event_ends_is_found_without_what_ended_before() {
    let (_home, ledger) = open();
    let plan = |sql: &'static str| {
        ledger
            .database
            .read(move |connection| Ok(statements::plan_of(connection.file().expect("a file"), sql)?.join("; ")))
            .expect("planned")
    };
    for sql in crate::ledger::directory::ENDING {
        let plan = plan(sql);
        assert!(plan.contains("INDEX rights_standing (owner=? AND kind=?"), "{plan}");
    }
}

#[test]
fn replaced_blocks_give_back_what_they_ended() {
    let (_home, ledger) = bound();
    let last = |ledger: &Ledger| ledger.rights.standing_rights().expect("read");
    assert_eq!(ledger.rights.standing_rights(), Ok(StandingRights::default()), "never read");
    ledger.rights.keep_rights(vec![event(5, RightKind::Grant, 1)]).expect("kept");
    let before = last(&ledger);
    ledger.rights.keep_rights(vec![event(6, RightKind::Epoch, 2)]).expect("kept");
    assert_ne!(last(&ledger).events, before.events);
    let between = |revoked| ledger.rights.envelopes_between(Address([1; 20]), Address([2; 20]), revoked);
    assert_eq!((between(None).map(|all| all.len()), between(Some(2)).map(|all| all.len())), (Ok(0), Ok(1)));
    ledger.rights.take_back_rights(6).expect("undone");
    assert_eq!(last(&ledger).events, before.events);
    assert_eq!(between(None).map(|all| all.len()), Ok(1));
    ledger.rights.keep_rights(vec![event(5, RightKind::Epoch, 9)]).expect("passed over");
    assert_eq!(last(&ledger).events, before.events);
    ledger.rights.forget_rights().expect("forgotten");
    assert_eq!(ledger.rights.standing_rights(), Ok(StandingRights::default()));
    assert_eq!(between(None), Ok(Vec::new()));
}

#[test]
fn what_an_owner_keeps_for_itself_is_history_at_once_and_found_by_epoch() {
    let (_home, ledger) = bound();
    let own = |block: u64, epoch: u64| RightEvent {
        grantee: None,
        token: None,
        place: 1,
        envelope: Some(vec![6; 360]),
        ..event(block, RightKind::Own, epoch)
    };
    for epoch in 1..=50 {
        ledger.rights.keep_rights(vec![event(epoch, RightKind::Epoch, epoch), own(epoch, epoch)]).expect("kept");
    }
    assert_eq!(ledger.rights.standing_rights().expect("read").events.len(), 1, "a start reads the newest epoch alone");
    let found = |from, to| ledger.rights.own_envelopes(Address([1; 20]), from, to).expect("read");
    let epochs: Vec<u64> = found(7, 9).iter().map(|envelope| envelope.epoch).collect();
    assert_eq!((epochs, found(1, 50).len()), (vec![7, 8, 9], 50));
    assert_eq!(ledger.rights.own_envelopes(Address([2; 20]), 1, 50), Ok(Vec::new()), "another's");
    assert_eq!(ledger.rights.envelope_at(9, 1), Ok(Some(vec![6; 360])));
    ledger.rights.take_back_rights(50).expect("undone");
    assert_eq!((found(1, 50).len(), ledger.rights.envelope_at(50, 1)), (49, Ok(None)));
}

server::on_a_server! {
    a_ledger_belongs_to_one_contract_for_good, replaced_blocks_give_back_what_they_ended, what_an_owner_keeps_for_itself_is_history_at_once_and_found_by_epoch,
}
