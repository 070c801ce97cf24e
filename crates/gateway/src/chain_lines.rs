//! The chain through any of several gateways: the one that answered last is asked first, then the others in order. Each
//! line is bound to one network, so another gateway cannot be another chain.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use async_trait::async_trait;
use serde_json::Value;

use crate::chain::{Relay, RelayError};

use super::chain_line::ChainLine;

/// Lines to the gateways of a fleet, in order.
pub struct ChainLines {
    lines: Vec<Arc<ChainLine>>,
    /// The place of the one that answered last.
    used: AtomicUsize,
}

impl ChainLines {
    /// Over these lines, beginning with the one at `used`.
    pub fn new(lines: Vec<Arc<ChainLine>>, used: usize) -> Self {
        Self { lines, used: AtomicUsize::new(used) }
    }
}

#[async_trait]
impl Relay for ChainLines {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        let used = self.used.load(Ordering::Acquire);
        let others = (0..self.lines.len()).filter(|place| *place != used);
        let mut silent = RelayError::Silent("no gateway is named".to_owned());
        for place in [used].into_iter().chain(others) {
            let Some(line) = self.lines.get(place) else { continue };
            match line.ask(method, parameters.clone()).await {
                Err(error @ RelayError::Silent(_)) => silent = error,
                answered => {
                    self.used.store(place, Ordering::Release);
                    return answered;
                }
            }
        }
        Err(silent)
    }

    fn place(&self) -> String {
        match self.lines.get(self.used.load(Ordering::Acquire)) {
            Some(line) => line.place(),
            None => "no gateway".to_owned(),
        }
    }
}
