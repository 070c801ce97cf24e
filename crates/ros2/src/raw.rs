//! Samples of any type, as bytes with their encapsulation header.

use std::convert::Infallible;

use rustdds::no_key::{self, Decode, DeserializerAdapter};
use rustdds::{Keyed, RepresentationIdentifier, with_key};

/// A serialised sample: four bytes of header, then the body. The network code does not provide the options in the
/// header's last two bytes, which are 0 here.
#[derive(Debug, Clone)]
pub struct Raw(pub Vec<u8>);

/// Accepts samples as they are.
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

// Writers of a type with a key take only readers that have one, too. Here every sample counts, whatever its key, so that all of
// them are of one instance.
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
