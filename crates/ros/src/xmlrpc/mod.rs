//! A small XML-RPC over HTTP, client and server, with a deadline on every call and a cap on every size. It knows
//! values, requests and responses; what the calls mean is up to graph, capture and robots.

mod client;
mod http;
mod parse;
mod server;
mod value;

pub(super) use client::{CallError, call, forward};
pub(super) use server::{Answer, OF_A_NODE, Server};
pub(super) use value::Value;
