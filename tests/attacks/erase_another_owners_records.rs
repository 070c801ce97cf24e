//! An owner whom a gateway admits wants another owner's records gone: he tells the gateway that they were erased, in his own
//! session and in one that he stole from her together with her d_C. Then she tells it herself, with both her keys.

use std::time::Duration;

use authros::gateway::{Code, ErasureOutcome, GatewayError};

use super::erase_a_fleet_with_one_key::{lies, stored, told_of};
use super::support::gate::Gate;
use super::support::member::{Member, connect};
use super::support::{Home, list};
use super::{Outcome, judge};

#[tokio::test(flavor = "multi_thread")]
async fn erase_another_owners_records() {
    let (gate, away) = (Gate::new(), Home::new());
    let keeper = gate.home.profile("gateway");
    let member = |name: &str| {
        away.profile(name).with(&gate.options()).enrol();
        let member = Member::of(&away, name, gate.gateway.domain);
        keeper.json(&["gateway", "admit", &member.address().to_string()]);
        member
    };
    let (carol, mallory) = (member("carol"), member("mallory"));
    let (hers, his) = ((&carol.keyring.signing, &carol.keyring.eoa), &mallory.keyring.eoa);
    let stolen = carol.allocate(&gate.gateway, "scout-1").await.expect("admitted");
    let own = mallory.allocate(&gate.gateway, "scout-2").await.expect("admitted");
    let (mut as_her, mut as_himself) = (connect(&gate.gateway, &stolen).await, connect(&gate.gateway, &own).await);
    let upload = |seq, body: &[u8]| carol.record(&carol.keyring.signing, "/odom", seq, body);
    let records = stored(&mut as_her, vec![upload(1, b"a face"), upload(2, b"another one")], carol.provider()).await;

    // In his own session nothing of hers is heard, whoever signed it.
    let mut wrong = Vec::new();
    for keys in [hers, (&carol.keyring.signing, his), (&mallory.keyring.signing, his)] {
        match as_himself.tell_erasures(vec![told_of(&carol, &records[0], keys)]).await {
            Err(GatewayError::Refused(Code::NotAuthorised)) => {}
            other => wrong.push(format!("in his own session: {other:?}")),
        }
    }
    // In hers, with d_C and without her account. What says that it is another owner's is none of hers.
    let mut refused = 0;
    for lie in lies(&carol, &mallory, &records) {
        match as_her.tell_erasures(vec![lie]).await {
            Ok(outcomes) if outcomes == [ErasureOutcome::Refused] => refused += 1,
            other => wrong.push(format!("in her session: {other:?}")),
        }
    }
    let mut kept = true;
    for (digest, record) in &records {
        kept &= as_her.fetch(digest).await.ok().as_ref() == Some(record);
    }
    let audit = || list(&keeper.json(&["audit", "list", "--action", "fleet erase"]), "audit");
    let before = audit();

    let word = as_her.tell_erasures(vec![told_of(&carol, &records[0], hers)]).await;
    let mut gone = false;
    for _ in 0..100 {
        gone = matches!(as_her.fetch(&records[0].0).await, Err(GatewayError::Erased(_)));
        if gone {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let outcome = if !kept || !before.is_empty() {
        Outcome::Succeeded(format!("records are gone: {before:?} {wrong:?}"))
    } else if !wrong.is_empty() || !gone || audit().len() != 1 {
        Outcome::Otherwise(format!("{wrong:?}; her own word: {word:?}, gone: {gone}, {:?}", audit()))
    } else {
        Outcome::Refused(format!("NotAuthorised in his session, {refused} lies refused in hers"))
    };
    judge("erase_another_owners_records", outcome);
}
