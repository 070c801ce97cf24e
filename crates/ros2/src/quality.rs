//! Offered and requested quality, sizes of caches, and samples of any type as bytes with their encapsulation header.

use std::convert::Infallible;

use crate::pipe::read::{Liveliness, Quality};
use rustdds::discovery::PublicationBuiltinTopicData;
use rustdds::no_key::{self, Decode, DeserializerAdapter};
use rustdds::policy::{self, DataRepresentation, Durability, History, Reliability, ResourceLimits};
use rustdds::qos::policy::{XCDR_DATA_REPRESENTATION, XCDR2_DATA_REPRESENTATION};
use rustdds::{Duration, Keyed, QosPolicies, QosPolicyBuilder, RepresentationIdentifier, with_key};

/// Samples of a topic kept before their size is known.
pub const FIRST_DEPTH: usize = 16;
const MOST_DEPTH: usize = 1000;
const LEAST_DEPTH: usize = 4;
/// Bytes of kept samples, of one topic and of all.
const TOPIC_BYTES: usize = 32 << 20;
const ALL_BYTES: usize = 256 << 20;

pub fn offered(told: &PublicationBuiltinTopicData) -> Quality {
    Quality {
        // A writer that does not say so is reliable, by the standard's default.
        reliable: !matches!(told.reliability, Some(Reliability::BestEffort)),
        latched: told.durability.is_some_and(|durability| durability >= Durability::TransientLocal),
        deadline: told.deadline.and_then(|deadline| nanoseconds(deadline.0)),
        lifespan: told.lifespan.and_then(|lifespan| nanoseconds(lifespan.duration)),
        liveliness: match told.liveliness {
            None | Some(policy::Liveliness::Automatic { .. }) => Liveliness::Automatic,
            Some(policy::Liveliness::ManualByParticipant { .. }) => Liveliness::ManualByParticipant,
            Some(policy::Liveliness::ManualByTopic { .. }) => Liveliness::ManualByTopic,
        },
        lease: told.liveliness.and_then(|liveliness| nanoseconds(liveliness.duration())),
    }
}

/// The wire rounds nanoseconds down to 2^-32 s; this gives the original. `None` for an endless time.
fn nanoseconds(duration: Duration) -> Option<u64> {
    if duration >= Duration::INFINITE {
        return None;
    }
    let least = duration.to_nanoseconds();
    let is_next = Duration::from_nanos(least.saturating_add(1)) == duration;
    u64::try_from(least.saturating_add(i64::from(is_next))).ok()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    pub reliable: bool,
    pub latched: bool,
}

/// What every offer provides: more would exclude a writer.
pub fn request(offers: impl Iterator<Item = Quality> + Clone) -> Request {
    Request { reliable: offers.clone().all(|offer| offer.reliable), latched: offers.clone().all(|offer| offer.latched) }
}

pub fn policies(request: Request, depth: usize) -> QosPolicies {
    let depth = i32::try_from(depth).unwrap_or(i32::MAX);
    let builder = QosPolicyBuilder::new()
        .durability(if request.latched { Durability::TransientLocal } else { Durability::Volatile })
        .history(History::KeepLast { depth })
        .resource_limits(ResourceLimits { max_samples: depth, max_instances: 1, max_samples_per_instance: depth });
    let builder = if request.reliable { builder.reliable(Duration::from_millis(100)) } else { builder.best_effort() };
    let both = vec![XCDR_DATA_REPRESENTATION, XCDR2_DATA_REPRESENTATION];
    builder.build().with_data_representation(DataRepresentation { value: both })
}

/// Only the topic's own cache limits untaken samples of a type with a key.
pub fn of_keyed(policies: &QosPolicies) -> QosPolicies {
    policies.modify_by(&QosPolicyBuilder::new().history(History::KeepAll).build())
}

/// A writer offers only the first version of CDR.
pub fn plain(policies: &QosPolicies) -> QosPolicies {
    policies.clone().with_data_representation(DataRepresentation { value: vec![XCDR_DATA_REPRESENTATION] })
}

pub fn depth(sample: usize, others: usize) -> usize {
    let bytes = TOPIC_BYTES.min(ALL_BYTES.saturating_sub(others) / 2);
    (bytes / sample.max(1)).clamp(LEAST_DEPTH, MOST_DEPTH)
}

/// Four bytes of header, then the body. rustdds does not provide the header's options, which are 0 here.
#[derive(Debug, Clone)]
pub struct Raw(pub Vec<u8>);

pub struct RawAdapter;

impl DeserializerAdapter<Raw> for RawAdapter {
    type Error = Infallible;
    type Decoded = Raw;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        use RepresentationIdentifier as Id;
        const ALL: &[RepresentationIdentifier] = &[
            Id::CDR_LE,
            Id::CDR_BE,
            Id::PL_CDR_LE,
            Id::PL_CDR_BE,
            Id::CDR2_LE,
            Id::CDR2_BE,
            Id::PL_CDR2_LE,
            Id::PL_CDR2_BE,
            Id::D_CDR_LE,
            Id::D_CDR_BE,
            Id::XCDR2_LE,
            Id::XCDR2_BE,
            Id::D_CDR2_LE,
            Id::D_CDR2_BE,
            Id::PL_XCDR2_LE,
            Id::PL_XCDR2_BE,
        ];
        ALL
    }

    fn transform_decoded(decoded: Raw) -> Raw {
        decoded
    }
}

/// Puts the header before the body.
#[derive(Debug, Clone, Copy)]
pub struct RawDecoder;

impl Decode<'_, Raw> for RawDecoder {
    type Error = Infallible;

    fn decode_bytes(self, input_bytes: &[u8], encoding: RepresentationIdentifier) -> Result<Raw, Infallible> {
        let mut bytes = Vec::with_capacity(input_bytes.len() + 4);
        bytes.extend_from_slice(&encoding.to_bytes());
        bytes.extend_from_slice(&[0, 0]);
        bytes.extend_from_slice(input_bytes);
        Ok(Raw(bytes))
    }
}

// Writers of a type with a key accept only readers with one. Every sample counts here whatever its key, so all are of
// one instance.
impl Keyed for Raw {
    type K = ();

    fn key(&self) {}
}

impl with_key::DeserializerAdapter<Raw> for RawAdapter {
    type DecodedKey = ();

    fn transform_decoded_key((): ()) {}
}

impl no_key::DefaultDecoder<Raw> for RawAdapter {
    type Decoder = RawDecoder;
    const DECODER: RawDecoder = RawDecoder;
}

impl with_key::DefaultDecoder<Raw> for RawAdapter {
    type Decoder = RawDecoder;
    const DECODER: RawDecoder = RawDecoder;
}

impl with_key::Decode<'_, Raw, ()> for RawDecoder {
    fn decode_key_bytes(self, _: &[u8], _: RepresentationIdentifier) -> Result<(), Infallible> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quality(reliable: bool, latched: bool) -> Quality {
        Quality { reliable, latched, ..Quality::default() }
    }

    #[test]
    fn a_request_is_what_every_offer_gives() {
        let asked = |offers: &[(bool, bool)]| {
            let asked = request(offers.iter().map(|(reliable, latched)| quality(*reliable, *latched)));
            (asked.reliable, asked.latched)
        };
        assert_eq!(asked(&[(true, true), (true, true)]), (true, true));
        assert_eq!(asked(&[(true, true), (true, false)]), (true, false));
        assert_eq!(asked(&[(true, false), (false, false)]), (false, false));
    }

    #[test]
    fn what_is_not_said_is_the_default_of_the_standard() {
        let told = |reliability, durability| PublicationBuiltinTopicData {
            reliability,
            durability,
            ..PublicationBuiltinTopicData::new(rustdds::GUID::from_bytes([1; 16]), None, "a".into(), "b".into(), None)
        };
        assert_eq!(offered(&told(None, None)), quality(true, false));
        assert_eq!(
            offered(&told(Some(Reliability::BestEffort), Some(Durability::TransientLocal))),
            quality(false, true)
        );
        let mut long = told(None, None);
        long.deadline = Some(rustdds::policy::Deadline(Duration::INFINITE));
        assert_eq!(offered(&long).deadline, None);
    }

    #[test]
    fn what_is_said_is_told_to_the_nanosecond() {
        let mut told =
            PublicationBuiltinTopicData::new(rustdds::GUID::from_bytes([1; 16]), None, "a".into(), "b".into(), None);
        for nanoseconds in [1, 100_000_000, 999_999_999, 1_000_000_000, 2_300_000_001, 86_400_000_000_007] {
            let length = i64::try_from(nanoseconds).map(Duration::from_nanos).expect("small");
            told.deadline = Some(policy::Deadline(length));
            told.liveliness = Some(policy::Liveliness::ManualByTopic { lease_duration: length });
            let offer = offered(&told);
            assert_eq!((offer.deadline, offer.lease), (Some(nanoseconds), Some(nanoseconds)));
            assert_eq!(offer.liveliness, Liveliness::ManualByTopic);
        }
        told.liveliness = Some(policy::Liveliness::ManualByParticipant { lease_duration: Duration::INFINITE });
        let offer = offered(&told);
        assert_eq!((offer.liveliness, offer.lease), (Liveliness::ManualByParticipant, None));
    }

    #[test]
    fn what_is_kept_is_bounded_by_bytes() {
        assert_eq!(depth(100, 0), 1000);
        assert_eq!(depth(1 << 20, 0), 32);
        assert_eq!(depth(8 << 20, 0), 4);
        assert_eq!(depth(1 << 20, 240 << 20), 8);
        assert_eq!(depth(1 << 20, 1 << 40), 4);
        assert_eq!(depth(0, 0), 1000);
    }
}
