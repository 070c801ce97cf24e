//! When a table is built, and which one is evicted.

use super::*;
use crate::sm2::{IDLE, SIGHTINGS, Signers, of_process, verify_among};

/// So many verifications, of whatever signatures, once made all others replaceable.
const FLOOD: u32 = (1 << 16) + 1;
const NONE: Signature = Signature([0; 64]);

/// Somebody who signs, and a signature of hers.
struct Person {
    public: PublicKey,
    signature: Signature,
}

impl Person {
    fn is_valid(&self, signers: &Signers, now: u64) -> bool {
        verify_among(signers, now, &self.public, b"x", &self.signature).is_ok()
    }

    fn is_known(&self, signers: &Signers) -> bool {
        signers.known(&self.public).is_some()
    }
}

fn people<const COUNT: usize>(noise: &mut Noise) -> [Person; COUNT] {
    std::array::from_fn(|_| {
        let key = key(noise).1;
        Person { public: *key.public(), signature: key.sign(b"x", &noise.array()) }
    })
}

fn meet_often(signers: &Signers, one: &Person, now: u64) {
    (0..SIGHTINGS).for_each(|_| assert!(one.is_valid(signers, now)));
}

/// So many valid signatures of strangers, each of whom comes often enough for a table.
fn strangers(signers: &Signers, count: u32, now: u64) {
    let (point, za) = (Affine::from_bytes(&people::<1>(&mut Noise(45))[0].public.0).expect("a point"), [0; 32]);
    for stranger in 0..count {
        let mut public = PublicKey([7; 64]);
        public.0[..4].copy_from_slice(&(stranger / u32::from(SIGHTINGS)).to_be_bytes());
        signers.seen(&public, &point, &za, now);
    }
}

#[test]
fn a_table_is_made_at_the_third_sighting() {
    let (signers, [one]) = (Signers::new(4), people(&mut Noise(41)));
    for sighting in 1..=SIGHTINGS {
        assert!(!one.is_known(&signers), "before sighting {sighting}");
        assert!(one.is_valid(&signers, 0));
    }
    assert_eq!(signers.known(&one.public).expect("known").za, za(&one.public));
}

#[test]
fn however_many_strangers_come_they_evict_nobody() {
    let (signers, regulars) = (Signers::new(4), people::<4>(&mut Noise(42)));
    regulars.iter().for_each(|one| meet_often(&signers, one, 0));
    strangers(&signers, FLOOD * u32::from(SIGHTINGS), IDLE - 1);
    assert!(regulars.iter().all(|one| one.is_known(&signers)));
}

#[test]
fn a_flood_under_a_known_key_evicts_nobody_valid_or_not() {
    let (signers, [flooder, quiet]) = (Signers::new(2), people(&mut Noise(43)));
    meet_often(&signers, &flooder, 0);
    meet_often(&signers, &quiet, 0);
    for _ in 0..FLOOD {
        assert!(verify_among(&signers, 1, &flooder.public, b"x", &NONE).is_err());
    }
    strangers(&signers, u32::from(SIGHTINGS), 1);
    assert!(quiet.is_known(&signers), "anybody can send what is not valid");
    for _ in 0..FLOOD {
        signers.known(&flooder.public).expect("known").used(1);
    }
    strangers(&signers, u32::from(SIGHTINGS), 1);
    assert!(quiet.is_known(&signers), "a valid signature can be sent again and again");
}

/// Otherwise the tables of a crowd that came once would stay for ever.
#[test]
fn who_signs_nothing_valid_for_an_hour_gives_way() {
    let (signers, [one, other, third]) = (Signers::new(2), people(&mut Noise(44)));
    meet_often(&signers, &one, 0);
    meet_often(&signers, &other, 0);
    assert!(one.is_valid(&signers, IDLE - 1));
    assert!(verify_among(&signers, IDLE - 1, &other.public, b"x", &NONE).is_err(), "not valid: not a use");
    meet_often(&signers, &third, IDLE - 1);
    assert!(other.is_known(&signers) && !third.is_known(&signers), "not yet");
    meet_often(&signers, &third, IDLE);
    assert!(one.is_known(&signers) && third.is_known(&signers) && !other.is_known(&signers));
    assert!(other.is_valid(&signers, IDLE), "only slower");
}

/// Only valid signatures count as sightings: forgeries build no table.
#[test]
fn forgeries_are_no_sightings() {
    let [one] = people(&mut Noise(46));
    for _ in 0..10 {
        assert!(verify(&one.public, b"x", &Signature([1; 64])).is_err());
    }
    assert!(!one.is_known(of_process().0));
}

#[test]
fn who_fell_silent_makes_room_as_soon_as_the_hour_is_over_though_nobody_looked_before() {
    let (signers, [quiet, busy, new]) = (Signers::new(2), people(&mut Noise(47)));
    meet_often(&signers, &quiet, 10);
    meet_often(&signers, &busy, 0);
    // All tables are looked at, and again after one was used.
    strangers(&signers, u32::from(SIGHTINGS), IDLE - 1);
    signers.known(&busy.public).expect("known").used(IDLE - 1);
    strangers(&signers, u32::from(SIGHTINGS), IDLE + 9);
    assert!(quiet.is_known(&signers) && busy.is_known(&signers));
    meet_often(&signers, &new, IDLE + 10);
    assert!(new.is_known(&signers) && busy.is_known(&signers) && !quiet.is_known(&signers));
}
