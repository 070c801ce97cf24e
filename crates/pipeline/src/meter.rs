//! Rates of topics over a sliding window, in constant memory.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use crate::model::Timestamp;

const WINDOW: u64 = 5;

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rate {
    pub hz: f64,
    pub bytes_per_second: f64,
    pub messages: u64,
    pub last: Option<Timestamp>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Bucket {
    second: u64,
    messages: u32,
    bytes: u64,
}

#[derive(Debug, Default)]
struct Track {
    buckets: [Bucket; 8],
    first_second: u64,
    messages: u64,
    last: Option<Timestamp>,
}

#[derive(Debug, Default)]
pub struct Meter {
    tracks: Mutex<HashMap<String, Track>>,
}

impl Meter {
    pub fn count(&self, topic: &str, bytes: usize, at: Timestamp) {
        let mut tracks = self.tracks.lock().unwrap_or_else(PoisonError::into_inner);
        let second = at.seconds();
        if !tracks.contains_key(topic) {
            tracks.insert(topic.to_owned(), Track { first_second: second, ..Track::default() });
        }
        let Some(track) = tracks.get_mut(topic) else { return };
        let slot = &mut track.buckets[usize::try_from(second % 8).unwrap_or(0)];
        if slot.second != second {
            *slot = Bucket { second, ..Bucket::default() };
        }
        slot.messages += 1;
        slot.bytes += bytes as u64;
        track.messages += 1;
        track.last = Some(at);
    }

    /// The rate of `topic` over the whole seconds before `now`; `None` if it was never seen.
    pub fn rate(&self, topic: &str, now: Timestamp) -> Option<Rate> {
        let tracks = self.tracks.lock().unwrap_or_else(PoisonError::into_inner);
        let track = tracks.get(topic)?;
        let now = now.seconds();
        let span = now.saturating_sub(track.first_second).clamp(1, WINDOW);
        let current = |bucket: &&Bucket| bucket.second < now.max(1) && bucket.second + span >= now;
        let started = now == track.first_second;
        let (mut messages, mut bytes) = (0_u64, 0_u64);
        for bucket in track.buckets.iter().filter(|bucket| current(bucket) || started && bucket.second == now) {
            messages += u64::from(bucket.messages);
            bytes += bucket.bytes;
        }
        let seconds = u32::try_from(span).map_or(1.0, f64::from);
        let per_second = |total: u64| u32::try_from(total).map_or(f64::from(u32::MAX), f64::from) / seconds;
        Some(Rate {
            hz: per_second(messages),
            bytes_per_second: per_second(bytes),
            messages: track.messages,
            last: track.last,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_topic_shows_its_rate_and_an_ended_one_falls_to_zero() {
        let meter = Meter::default();
        for tick in 0..200_u64 {
            meter.count("/odom", 100, Timestamp(100_000_000_000 + tick * 50_000_000));
        }
        let rate = meter.rate("/odom", Timestamp::from_seconds(110)).expect("seen");
        assert!((rate.hz - 20.0).abs() < 1e-9, "{rate:?}");
        assert!((rate.bytes_per_second - 2000.0).abs() < 1e-9);
        assert_eq!(rate.messages, 200);
        let later = meter.rate("/odom", Timestamp::from_seconds(200)).expect("seen");
        assert!(later.hz.abs() < 1e-9);
        assert_eq!(meter.rate("/other", Timestamp::now()), None);
    }
}
