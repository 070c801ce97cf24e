//! The calculations, and one short measurement of each algorithm.

use super::*;
use authros_crypto::{ProviderName, provider};

fn example(work: &'static str, by: &'static str, bytes: usize, times: &[f64]) -> Row {
    row(work, by, bytes, times.to_vec())
}

#[test]
fn outliers_are_listed_and_ratios_are_of_the_least_times() {
    let mut times = vec![10.0; 98];
    times.extend([20.0, 40.0]);
    let one = example("seal", "authros", 8192, &times);
    assert_eq!((one.p5, one.measured.spread.p95), (10.0, 10.0));
    assert_eq!(one.outliers, [40.0, 20.0]);
    let rows = [one, example("seal", "crates", 8192, &[30.0, 25.0])];
    assert_eq!(ratio(&rows, 8192, ("seal", "crates"), ("seal", "authros")), Some(2.5));
    assert_eq!(ratio(&rows, 8192, ("seal", "libsm"), ("seal", "authros")), None);
}

#[test]
fn what_was_not_measured_is_not_judged() {
    assert!(targets_of_sm4(&[]).is_empty() && targets_of_sm3(&[]).is_empty());
    let slow = [example("digest", "authros", LARGEST, &[3000.0])];
    let judged: Vec<bool> = targets_of_sm3(&slow).iter().map(|one| one.ok).collect();
    assert_eq!(judged, [false, true], "over a third of the paper's time, but steady");
}

#[test]
fn sm2_is_judged_by_the_crates_time() {
    let of = |work, by, time| example(work, by, SIGNED, &[time]);
    let mut rows = vec![of("sign", "authros", 20.0), of("sign", "crate", 100.0), of("verify", "authros", 60.0)];
    rows.push(of("verify", "crate", 200.0));
    assert!(targets_of_sm2(&rows).is_empty(), "another provider in our place");
    rows.push(of("verify", work::KNOWN, 20.0));
    let judged: Vec<(bool, f64)> = targets_of_sm2(&rows).iter().map(|one| (one.ok, one.found)).collect();
    assert_eq!(judged, [(true, 0.2), (false, 0.3), (true, 0.1)]);
}

#[test]
fn each_algorithm_is_measured_by_all() {
    for (algorithm, rows_of_ours) in [(Algorithm::Sm2, 11), (Algorithm::Sm3, 9), (Algorithm::Sm4, 20)] {
        let (rows, other) = measure(algorithm, 1, provider(ProviderName::default())).expect("measures");
        let ours = rows.iter().filter(|row| row.by.starts_with("authros")).count();
        assert_eq!(ours, rows_of_ours, "{algorithm:?}");
        assert!(rows.iter().all(|row| row.measured.spread.min > 0.0 && row.measured.runs == 1));
        assert!(rows.iter().any(|row| row.by == "libsm"));
        let of_crate = rows.iter().filter(|row| row.by == "crate").count();
        assert_eq!(of_crate, if algorithm == Algorithm::Sm2 { 4 } else { 0 });
        let by_openssl = rows.iter().filter(|row| row.by.starts_with("openssl")).count();
        let expected = match algorithm {
            Algorithm::Sm2 | Algorithm::Sm3 => 2,
            Algorithm::Sm4 => 4,
        };
        assert_eq!(by_openssl, if other.starts_with("OpenSSL 3") { expected } else { 0 }, "{other}");
        assert!(other.starts_with("OpenSSL 3") || other.contains("was not timed"), "{other}");
    }
}
