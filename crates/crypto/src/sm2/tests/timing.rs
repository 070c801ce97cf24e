//! Whether timing reveals a secret, by the method of dudect: two classes in random order, Welch's t of their times,
//! with the slowest cut off at several thresholds. Under `AUTHROS_LONG`; reported, not judged, because a busy machine
//! gives false alarms.

use std::hint::black_box;
use std::time::Instant;

use super::*;
use crate::kernel::sm2::Signer as _;

/// For two samples: the difference of their means over its standard error.
fn welch(samples: &[Vec<f64>; 2]) -> f64 {
    let [one, other] = samples.each_ref().map(|times| {
        let count = f64::from(u32::try_from(times.len()).expect("few"));
        let mean = times.iter().sum::<f64>() / count;
        let variance = times.iter().map(|time| (time - mean).powi(2)).sum::<f64>() / (count - 1.0);
        (mean, variance / count)
    });
    (one.0 - other.0) / (one.1 + other.1).sqrt()
}

/// The t of all times, and of those below some percentiles.
fn report(name: &str, times: &[(usize, f64)]) {
    let mut sorted: Vec<f64> = times.iter().map(|(_, time)| *time).collect();
    sorted.sort_by(f64::total_cmp);
    for percent in [50, 80, 90, 95, 99, 100] {
        let bound = sorted[(sorted.len() * percent / 100).max(1) - 1];
        let of = |class| times.iter().filter(move |one| one.0 == class && one.1 <= bound).map(|one| one.1).collect();
        println!("{name}: times up to {percent} per cent: t = {:+.2}", welch(&[of(0), of(1)]));
    }
}

fn measured(name: &str, runs: usize, mut work: impl FnMut(usize, &mut Noise) -> f64) {
    let mut noise = Noise(51);
    for class in [0, 1].repeat(500) {
        work(class, &mut noise);
    }
    let times: Vec<(usize, f64)> = (0..runs)
        .map(|_| {
            let class = noise.below(2);
            (class, work(class, &mut noise))
        })
        .collect();
    report(name, &times);
}

fn timed<T>(work: impl FnOnce() -> T) -> f64 {
    let start = Instant::now();
    black_box(work());
    start.elapsed().as_secs_f64() * 1e9
}

#[test]
fn the_t_of_two_samples_is_what_it_should_be() {
    // Means 2 and 5, variances 1 and 1, three of each: -3 / sqrt(2 / 3).
    let t = welch(&[vec![1.0, 2.0, 3.0], vec![4.0, 5.0, 6.0]]);
    assert!((t + 3.0 / (2.0f64 / 3.0).sqrt()).abs() < 1e-12, "{t}");
}

#[test]
fn times_tell_nothing_of_secrets() {
    if !long() {
        return;
    }
    let runs = 400_000;
    let low = scalar("0000000000000000000000000000000000000000000000000000000000000003");
    let (_, signer) = key(&mut Noise(52));
    let e = hash(&za(signer.public()), b"message");
    let other = point(key(&mut Noise(53)).1.public()).expect("a point");
    let number = |class: usize, noise: &mut Noise| {
        let random = Scalar::reduced(&noise.array());
        // Both classes are prepared the same way, so that only the number differs.
        [low, random][class]
    };
    measured("signing, nonce 3 or random", runs, |class, noise| {
        let nonce = number(class, noise);
        timed(|| signer.sign_with(&e, black_box(&nonce)))
    });
    measured("a multiple of a point (decryption), factor 3 or random", runs, |class, noise| {
        let factor = number(class, noise);
        timed(|| crate::kernel::sm2::multiply(black_box(&factor), &other))
    });
    measured("signing, key fixed or random", runs / 4, |class, noise| {
        let random = key(noise).1;
        let chosen = [&signer, &random][class];
        let nonce = Scalar::reduced(&noise.array());
        timed(|| chosen.sign_with(&e, black_box(&nonce)))
    });
    let (fixed, public) = key(&mut Noise(54));
    measured("decryption, key fixed or random", runs / 4, |class, noise| {
        let (random, stranger) = key(noise);
        let (secret, public) = ([&fixed, &random][class], [&public, &stranger][class].public());
        let sealed = encrypt(public, b"text").expect("encrypts");
        timed(|| decrypt(black_box(secret), sealed))
    });
    // Verification need not be constant-time, so the method must detect it: otherwise it detects nothing.
    measured("for comparison: verification's multiple, factor 3 or random", runs / 8, |class, noise| {
        let factor = number(class, noise);
        timed(|| other.times(black_box(&factor)))
    });
}
