//! A forwarded request to the chain, and the outcome. JSON stays text, so that each message has one encoding.

use crate::error::{Code, Refusal, Result};
use crate::model::relay::RelayError;
use crate::model::wire::{Reader, WireError, put_text};

/// Bytes of JSON: a raw transaction of 32 KiB in hex, and a little more.
pub const LONGEST_PARAMETERS: usize = 72 * 1024;
/// Bytes of JSON.
pub const LONGEST_RESULT: usize = 32 * 1024 * 1024;
/// Bytes of JSON: more than any block's logs.
pub const LONGEST_FOR_VISITOR: usize = 8 * 1024 * 1024;
const LONGEST_METHOD: usize = 64;
const LONGEST_WORDS: usize = 2 * 1024;
/// Bytes of JSON.
const LONGEST_DATA: usize = 64 * 1024;
const RESULT: u8 = 0;
const FAULT: u8 = 1;

/// length of the method (1) || method || parameters, a JSON array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RelayCall {
    pub method: String,
    pub parameters: String,
}

impl RelayCall {
    pub(super) fn encode(&self) -> Vec<u8> {
        let method = self.method.as_bytes();
        let method = &method[..method.len().min(LONGEST_METHOD)];
        [&[u8::try_from(method.len()).unwrap_or(0)], method, self.parameters.as_bytes()].concat()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let length = usize::from(reader.u8("method")?);
        if !(1..=LONGEST_METHOD).contains(&length) {
            return Err(WireError::Value("method"));
        }
        let method = text(reader.take(length, "method")?, "method")?;
        if !method.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_') {
            return Err(WireError::Value("method"));
        }
        let parameters = rest(reader, LONGEST_PARAMETERS, "parameters")?;
        if parameters.is_empty() { Err(WireError::Value("parameters")) } else { Ok(Self { method, parameters }) }
    }
}

/// 0 (1) || result, or 1 (1) || code (8) || length of the words (2) || words || data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Relayed {
    /// JSON.
    Result(String),
    Fault {
        code: i64,
        /// Cleaned.
        words: String,
        /// JSON; empty for none.
        data: String,
    },
}

impl Relayed {
    /// A result longer than `most` bytes becomes an error that asks for less. Refuses with `Method` a method that is
    /// not forwarded, with `Stale` a silent chain.
    pub fn of(outcome: Result<serde_json::Value, RelayError>, most: usize) -> Result<Self> {
        match outcome {
            Ok(result) => {
                let text = result.to_string();
                if text.len() > most {
                    let words = format!("the answer is longer than {most} bytes; request less");
                    return Ok(Self::Fault { code: -32005, words, data: String::new() });
                }
                Ok(Self::Result(text))
            }
            Err(RelayError::Answered { code, mut message, data }) => {
                message.truncate(message.floor_char_boundary(LONGEST_WORDS));
                let data = data.map(|data| data.to_string()).filter(|data| data.len() <= LONGEST_DATA);
                Ok(Self::Fault { code, words: message, data: data.unwrap_or_default() })
            }
            Err(error @ RelayError::NotAllowed) => Err(Refusal::new(Code::Method, error)),
            Err(RelayError::Silent(reason)) => Err(Refusal::new(Code::Stale, reason)),
        }
    }

    /// Approximate, in bytes.
    pub(super) fn length(&self) -> usize {
        match self {
            Self::Result(result) => result.len(),
            Self::Fault { words, data, .. } => words.len() + data.len(),
        }
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        match self {
            Self::Result(result) => [&[RESULT], result.as_bytes()].concat(),
            Self::Fault { code, words, data } => {
                let mut out = vec![FAULT];
                out.extend_from_slice(&code.to_be_bytes());
                put_text(&mut out, words);
                out.extend_from_slice(data.as_bytes());
                out
            }
        }
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        match reader.u8("outcome")? {
            RESULT => {
                let result = rest(reader, LONGEST_RESULT, "result")?;
                if result.is_empty() { Err(WireError::Value("result")) } else { Ok(Self::Result(result)) }
            }
            FAULT => {
                let code = i64::from_be_bytes(reader.array("fault")?);
                let words = reader.text("fault")?;
                if words.len() > LONGEST_WORDS {
                    return Err(WireError::Value("fault"));
                }
                Ok(Self::Fault { code, words, data: rest(reader, LONGEST_DATA, "fault")? })
            }
            _ => Err(WireError::Value("outcome")),
        }
    }
}

fn text(bytes: &[u8], field: &'static str) -> Result<String, WireError> {
    String::from_utf8(bytes.to_vec()).map_err(|_| WireError::Value(field))
}

fn rest(reader: &mut Reader<'_>, most: usize, field: &'static str) -> Result<String, WireError> {
    let length = reader.rest().len();
    if length > most {
        return Err(WireError::Value(field));
    }
    text(reader.take(length, field)?, field)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    proptest! {
        #[test]
        fn calls_and_answers_come_back_as_they_went(
            method in "[a-zA-Z0-9_]{1,64}", parameters in ".{1,300}", code: i64, words in ".{0,400}", data in ".{0,300}"
        ) {
            let call = RelayCall { method, parameters: parameters.clone() };
            let bytes = call.encode();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(RelayCall::read(&mut reader), Ok(call));
            for relayed in [Relayed::Result(parameters), Relayed::Fault { code, words, data }] {
                let bytes = relayed.encode();
                prop_assert_eq!(Relayed::read(&mut Reader::new(&bytes)), Ok(relayed));
            }
        }

        #[test]
        fn garbage_never_panics_and_has_one_encoding(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(call) = RelayCall::read(&mut Reader::new(&noise)) {
                prop_assert_eq!(call.encode(), noise.clone());
            }
            if let Ok(relayed) = Relayed::read(&mut Reader::new(&noise)) {
                prop_assert_eq!(relayed.encode(), noise);
            }
        }
    }

    #[test]
    fn every_length_is_bounded() {
        let call = |method: &str, parameters: usize| {
            let method = [&[u8::try_from(method.len()).expect("short")], method.as_bytes()].concat();
            RelayCall::read(&mut Reader::new(&[method, vec![b'['; parameters]].concat()))
        };
        assert!(call("eth_call", 1).is_ok() && call("eth_call", LONGEST_PARAMETERS).is_ok());
        for (method, parameters) in [("", 1), ("eth_call", 0), ("eth_call", LONGEST_PARAMETERS + 1), ("eth call", 1)] {
            assert!(call(method, parameters).is_err(), "{method} {parameters}");
        }
        assert!(call(&"x".repeat(65), 1).is_err());
        assert!(Relayed::read(&mut Reader::new(&[RESULT])).is_err());
        assert!(Relayed::read(&mut Reader::new(&[2, b'1'])).is_err());
    }

    #[test]
    fn what_a_node_says_is_passed_on_and_the_rest_is_a_code() {
        let of = |outcome| Relayed::of(outcome, LONGEST_RESULT);
        let Ok(Relayed::Fault { code: -32005, .. }) = Relayed::of(Ok(json!("four")), 5) else { panic!("too long") };
        assert_eq!(of(Ok(json!({"a": 1}))), Ok(Relayed::Result("{\"a\":1}".into())));
        let reverted = RelayError::Answered { code: 3, message: "reverted".into(), data: Some(json!("0x08")) };
        let fault = Relayed::Fault { code: 3, words: "reverted".into(), data: "\"0x08\"".into() };
        assert_eq!(of(Err(reverted)), Ok(fault));
        assert_eq!(of(Err(RelayError::NotAllowed)).expect_err("refused").code, Code::Method);
        assert_eq!(of(Err(RelayError::Silent("x".into()))).expect_err("refused").code, Code::Stale);
        let long = RelayError::Answered { code: 3, message: "ä".repeat(3000), data: None };
        let Ok(Relayed::Fault { words, .. }) = of(Err(long)) else { panic!("a fault") };
        assert!(words.len() <= LONGEST_WORDS && words.ends_with('ä'));
    }
}
