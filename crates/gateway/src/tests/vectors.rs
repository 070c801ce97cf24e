//! The test vectors of PROTOCOL.md, recomputed: ephemerals and nonces are fixed, so only signatures differ.

use std::collections::HashMap;

use super::*;
use crate::crypto::{Ephemeral, SmSecret, TransportKey, kdf};
use crate::gateway::command::{Inner, Part, Speaker, split};
use crate::gateway::frame::{FrameKind, encode};
use crate::gateway::hello::{ClientHello, GatewayHello, ListSummary};
use crate::gateway::session::SessionId;
use crate::model::bytes::hex;
use crate::model::{Digest, Timestamp, Token};

const PROTOCOL: &str = include_str!("../PROTOCOL.md");

fn ephemeral(byte: u8) -> Ephemeral {
    Ephemeral::from_secret(context().provider, SmSecret::from_slice(&[byte; 32]).expect("in range")).expect("pair")
}

/// Every value of the vectors, by name.
fn computed() -> Vec<(&'static str, Vec<u8>)> {
    let list = ListSummary { version: 7, digest: Digest([0x77; 32]) };
    let client = ClientHello::with(context(), [0xc1; 32], ephemeral(0x41));
    let hello = client.encode();
    let drawn = ([0xd1; 32], SessionId([0x5e; 16]));
    let (answer, gateway) =
        GatewayHello::answer_with(context(), &pair(0x21), list, &hello, drawn, ephemeral(0x42)).expect("answers");
    let client = client.agree(&answer).expect("agrees");
    let key = TransportKey::new([0x4b; 32]);
    let mut out = vec![("client hello", hello), ("gateway answer, unsigned", answer[..218].to_vec())];
    out.extend(client.steps());
    let (identify, mut client) = client.identify(&"robot-1".parse().expect("a name"), Some(&key)).expect("seals");
    out.push(("identify", identify.clone()));
    let mut gateway = gateway.identified(&identify).expect("opens").session(Some(&key));
    out.extend(client.key_bytes());
    let command = Command::Ping;
    let token = Some(Token([0x70; 32]));
    let ping = Inner { command, part: Part::Whole, request: 1, token, signature: None, body: b"" }.encode(false);
    let sealed = client.seal(&ping).expect("seals");
    gateway.open(&sealed).expect("opens");
    out.push(("first ND2 of the client", ping));
    out.push(("first frame of the client", encode(FrameKind::Transfer, &sealed)));
    let pong = Answer::Time(Timestamp(1_700_000_000_000_000_000));
    let text = split(pong.command(), 1, Speaker::Gateway, &pong.encode()).remove(0);
    let sealed = gateway.seal(&text).expect("seals");
    client.open(&sealed).expect("opens");
    out.push(("first ND2 of the gateway", text));
    out.push(("first frame of the gateway", encode(FrameKind::Transfer, &sealed)));
    out.push(("gateway identity key", pair(0x21).public.0.to_vec()));
    out.push(("gateway fingerprint", kdf::signer_id(&pair(0x21).public).0.to_vec()));
    out
}

#[test]
fn the_documents_vectors_are_what_the_code_computes() {
    let section = PROTOCOL.split_once("## Test vectors").expect("a section of vectors").1;
    let written: HashMap<&str, &str> =
        section.lines().filter_map(|line| line.strip_prefix("- ")?.split_once(" = ")).collect();
    let computed = computed();
    let lines: Vec<String> = computed.iter().map(|(name, bytes)| format!("- {name} = {}", hex(bytes))).collect();
    let right = computed.iter().all(|(name, bytes)| written.get(name) == Some(&&*hex(bytes)));
    assert!(right && written.len() == computed.len(), "the section should be:\n{}", lines.join("\n"));
}
