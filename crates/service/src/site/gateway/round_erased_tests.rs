//! Gateways that tell what was erased, honest and lying ones: what they cost is bounded, and nothing is passed over.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

use async_trait::async_trait;

use super::*;
use crate::crypto::{AccountSignature, ErasedStatement};
use crate::gateway::{
    Code, ErasedRecord, Erasures, Fetched, GatewayError, HandedOver, Held, HoldingPlace, Holdings, ManyHandedOver,
    ToldErasure, Wanted,
};
use crate::model::{Address, Digest, PublicKey, RecorderId, Signature, Timestamp};
use crate::site::gateway::copies::Copies;
use crate::site::gateway::fetching::{Claim, Fetching, Which};
use crate::site::gateway::round::{Handed, Took};
use crate::store::Lacking;

const LEDGER: RecorderId = RecorderId([1; 16]);
const OWNER: Address = Address([2; 20]);

/// The record with a number, as [`Shelf`] reads it.
fn told(number: u8) -> ToldErasure {
    let (signer, signature) = (PublicKey([1; 64]), Signature([2; 64]));
    let record = Fetched { signer, signature, proof: Vec::new(), blob: Vec::new() };
    let statement = ErasedStatement { report: Digest([5; 32]), at: Timestamp(6), signer, signature };
    let left = ErasedRecord { record, statement };
    ToldErasure { digest: Digest([number; 32]), account_signature: AccountSignature([7; 65]), left }
}

fn page(numbers: impl IntoIterator<Item = u8>, number: u64, more: bool) -> Erasures {
    let next = ErasurePlace { ledger: LEDGER, number };
    Erasures { told: numbers.into_iter().map(told).collect(), next, more }
}

/// Erases what has a number below a hundred, leaves what is below two hundred, and refuses the rest.
#[derive(Default)]
struct Shelf {
    erased: Mutex<BTreeSet<u8>>,
    /// The anchor of this one is not known here.
    unseen: Option<u8>,
}

#[async_trait]
impl Here for Shelf {
    fn welcomes(&self, _: &Address) -> Result<(), Refusal> {
        Ok(())
    }

    fn lacking(&self, _: &[Held]) -> Result<Vec<Lacking>, Refusal> {
        Ok(Vec::new())
    }

    fn copies(&self) -> Copies {
        Copies::All
    }

    fn claim(&self, which: Which, wanted: Vec<u64>) -> Claim {
        Arc::new(Fetching::default()).claim(which, wanted)
    }

    async fn take(&self, _: Vec<Handed>) -> Result<Took, Refusal> {
        Ok(Took::default())
    }

    async fn erase(&self, told: Vec<ToldErasure>, patient: bool, round: &mut Round) -> Result<TookErased, Refusal> {
        let mut took = TookErased::default();
        for one in told {
            let number = one.digest.0[0];
            if self.unseen == Some(number) {
                if patient {
                    took.waits = true;
                    break;
                }
                took.left += 1;
            } else if number >= 200 {
                took.refused.push(Refusal::new(Code::Signature, "not the owner's"));
            } else if number >= 100 {
                took.left += 1;
            } else if self.erased.lock().expect("not poisoned").insert(number) {
                *round.erased.entry(OWNER).or_default() += 1;
            }
        }
        Ok(took)
    }
}

/// A gateway by a script.
struct Script<Tell> {
    tell: Tell,
    asked: usize,
}

#[async_trait]
impl<Tell: FnMut(ErasurePlace) -> Option<Erasures> + Send> Other for Script<Tell> {
    async fn holdings(&mut self, _: HoldingPlace) -> Result<Holdings, GatewayError> {
        Ok(Holdings::default())
    }

    async fn hand_over_many(&mut self, _: &[Wanted]) -> Result<Option<ManyHandedOver>, GatewayError> {
        Ok(None)
    }

    async fn hand_over(&mut self, _: Wanted) -> Result<HandedOver, GatewayError> {
        Ok(HandedOver::default())
    }

    async fn erasures(&mut self, after: ErasurePlace) -> Result<Option<Erasures>, GatewayError> {
        self.asked += 1;
        Ok((self.tell)(after))
    }
}

async fn rounds<Tell: FnMut(ErasurePlace) -> Option<Erasures> + Send>(
    tell: Tell,
    here: &Shelf,
    most: usize,
) -> (Script<Tell>, ErasureCourse, Round, Result<(), Ended>) {
    let (mut other, mut course, mut sum) = (Script { tell, asked: 0 }, ErasureCourse::default(), Round::default());
    let mut ended = Ok(());
    for _ in 0..most {
        ended = read_erasures(&mut other, here, &mut course, &mut sum).await;
        if ended.is_err() {
            break;
        }
    }
    (other, course, sum, ended)
}

fn lied(ended: &Result<(), Ended>) -> &str {
    match ended {
        Err(Ended::Lies(why)) => why,
        _ => "",
    }
}

#[tokio::test]
async fn all_of_it_is_read_page_by_page_and_then_only_what_is_new() {
    let here = Shelf::default();
    let honest = |after: ErasurePlace| {
        let number = if after.ledger == LEDGER { after.number } else { 0 };
        let last = (number + 2).min(50);
        let numbers = (number + 1..=last).map(|number| u8::try_from(number).expect("few"));
        Some(page(numbers, last, last < 50))
    };
    let (other, _, sum, ended) = rounds(honest, &here, 4).await;
    assert!(ended.is_ok() && sum.refused.is_empty(), "{ended:?}");
    assert_eq!((other.asked, sum.erased.get(&OWNER)), (8 + 8 + 8 + 1, Some(&50)));
    let (other, course, ..) = rounds(honest, &here, 6).await;
    assert_eq!(other.asked, 25 + 2, "behind the end it is asked once a round");
    assert!(course.at_end && !course.left);
}

#[tokio::test]
async fn a_gateway_of_an_earlier_version_is_asked_once_in_a_session() {
    let here = Shelf::default();
    let (mut other, mut course, _, ended) = rounds(|_| None, &here, 9).await;
    assert!(ended.is_ok() && other.asked == 1, "{}", other.asked);
    course.connected();
    read_erasures(&mut other, &here, &mut course, &mut Round::default()).await.expect("silent");
    assert_eq!(other.asked, 2, "it may be of a later version now");
}

#[tokio::test]
async fn lists_that_do_not_advance_or_begin_anew_for_ever_are_lies() {
    let here = Shelf::default();
    let (other, _, sum, ended) = rounds(|after| Some(page([1], after.number, true)), &here, 9).await;
    assert!(lied(&ended).contains("does not advance") && other.asked <= 2, "{ended:?}");
    assert!(sum.erased.len() <= 1);
    let (_, _, _, ended) = rounds(|after| Some(page([], if after.number == 0 { 9 } else { 8 }, true)), &here, 9).await;
    assert!(lied(&ended).contains("does not advance"), "backwards: {ended:?}");
    let mut number = 0;
    let anew = |_| {
        number += 1;
        let next = ErasurePlace { ledger: RecorderId([number; 16]), number: 1 };
        Some(Erasures { told: Vec::new(), next, more: true })
    };
    let (other, _, _, ended) = rounds(anew, &here, 9).await;
    assert!(lied(&ended).contains("does not advance") && other.asked == 2, "always another ledger: {ended:?}");
    // One that goes on for ever costs so many answers a round, and no more.
    let (other, ..) = rounds(|after| Some(page([], after.number + 1, true)), &here, 3).await;
    assert_eq!(other.asked, 3 * MOST_PAGES);
}

#[tokio::test]
async fn records_that_do_not_hold_end_the_round_and_those_beside_them_are_taken() {
    let here = Shelf::default();
    let (other, _, sum, ended) = rounds(|after| Some(page([1, 200, 201, 2], after.number + 1, true)), &here, 9).await;
    assert!(lied(&ended).contains("16 of the records"), "{ended:?}");
    assert_eq!((other.asked, sum.erased.get(&OWNER), sum.refused.get(&Code::Signature)), (8, Some(&2), Some(&16)));
}

#[tokio::test]
async fn an_anchor_that_is_not_seen_yet_is_waited_for_and_not_for_ever() {
    let mut here = Shelf { unseen: Some(2), ..Shelf::default() };
    let list = |after: ErasurePlace| {
        Some(match after.number {
            0 => page([1, 2, 3], 3, true),
            number => page([4], number.max(4), false),
        })
    };
    let (mut other, mut course, sum, _) = rounds(list, &here, 5).await;
    assert_eq!((other.asked, sum.erased.get(&OWNER)), (5, Some(&1)), "the same part each time");
    here.unseen = None;
    let mut round = Round::default();
    read_erasures(&mut other, &here, &mut course, &mut round).await.expect("goes on");
    assert_eq!((round.erased.get(&OWNER), course.left), (Some(&3), false));

    let here = Shelf { unseen: Some(2), ..Shelf::default() };
    let (_, course, sum, ended) = rounds(list, &here, 1 + usize::try_from(MOST_WAITS).expect("few")).await;
    assert!(ended.is_ok() && course.at_end && course.left, "passed over, and read again soon");
    assert_eq!(sum.erased.get(&OWNER), Some(&3));
}
