//! When a table is built, and which one is evicted.

use super::super::signers::{IDLE, SIGHTINGS, Signers};
use super::*;

fn people(count: usize, noise: &mut Noise) -> Vec<PublicKey> {
    (0..count).map(|_| *key(noise).1.public()).collect()
}

fn meet(signers: &Signers, public: &PublicKey) {
    if signers.known(public).is_none() {
        signers.seen(public, &point(public).expect("a point"), &za(public));
    }
}

fn meet_often(signers: &Signers, public: &PublicKey) {
    (0..SIGHTINGS).for_each(|_| meet(signers, public));
}

#[test]
fn a_table_is_made_at_the_third_sighting() {
    let (signers, public) = (Signers::new(4), people(1, &mut Noise(41))[0]);
    for sighting in 1..=SIGHTINGS {
        assert!(signers.known(&public).is_none(), "before sighting {sighting}");
        meet(&signers, &public);
    }
    assert_eq!(signers.known(&public).expect("known").za, za(&public));
}

#[test]
fn strangers_evict_nobody_who_is_in_use() {
    let (signers, mut noise) = (Signers::new(4), Noise(42));
    let regulars = people(4, &mut noise);
    regulars.iter().for_each(|public| meet_often(&signers, public));
    for stranger in people(40, &mut noise) {
        meet_often(&signers, &stranger);
        assert!(signers.known(&stranger).is_none());
        assert!(regulars.iter().all(|public| signers.known(public).is_some()));
    }
}

#[test]
fn who_stays_away_for_long_gives_way() {
    let (signers, mut noise) = (Signers::new(2), Noise(43));
    let [one, other, third] = <[PublicKey; 3]>::try_from(people(3, &mut noise)).expect("three");
    meet_often(&signers, &one);
    meet_often(&signers, &other);
    for _ in 0..IDLE {
        assert!(signers.known(&one).is_some());
    }
    meet_often(&signers, &third);
    assert!(signers.known(&one).is_some() && signers.known(&third).is_some());
    assert!(signers.known(&other).is_none());
}

/// Only valid signatures count as sightings: forgeries build no table.
#[test]
fn forgeries_are_no_sightings() {
    let public = people(1, &mut Noise(44))[0];
    for _ in 0..10 {
        assert!(verify(&public, b"x", &Signature([1; 64])).is_err());
    }
    assert!(super::super::signers::known(&public).is_none());
}
