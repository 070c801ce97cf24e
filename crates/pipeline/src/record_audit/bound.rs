//! The limit set by hashing alone: SM3 over memory, on as many threads as the audit had.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::crypto::Provider;

/// How long to measure.
const SPAN: Duration = Duration::from_millis(120);
/// Bytes hashed at a time.
const PIECE: usize = 1 << 20;

/// Megabytes (10^6) a second of SM3 on `threads` threads at once.
pub(super) fn sm3_rate(provider: &'static dyn Provider, threads: usize) -> f64 {
    let piece = vec![0x5a; PIECE];
    let pieces = AtomicU64::new(0);
    let begun = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(|| {
                while begun.elapsed() < SPAN {
                    std::hint::black_box(provider.sm3(&[&piece]));
                    pieces.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
    });
    #[expect(clippy::cast_precision_loss, reason = "a rate for people")]
    let bytes = (pieces.into_inner() * PIECE as u64) as f64;
    bytes / begun.elapsed().as_secs_f64() / 1e6
}
