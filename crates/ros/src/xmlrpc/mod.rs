//! A small XML-RPC over HTTP, client and server, every call under a deadline and every size capped.
//! It knows values, requests and responses; what the calls mean is the business of graph, capture and robots.

mod client;
mod http;
mod parse;
mod server;
mod value;

pub(super) use client::{CallError, call};
pub(super) use server::{Answer, Server};
pub(super) use value::Value;
