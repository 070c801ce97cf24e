//! The chain through a gateway, over one connection that reconnects; a visitor's session until there are credentials.

use std::sync::{Arc, PoisonError, RwLock};

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::Mutex;

use crate::client::{Client, Credentials, Endpoint};
use crate::error::{Code, GatewayError};
use crate::model::relay::{Relay, RelayError};
use crate::{command::Relayed, hello::Agreed, model::ProfileName, trust::KeptTrust};

pub struct ChainLine {
    endpoint: Endpoint,
    trust: Arc<KeptTrust>,
    visitor: ProfileName,
    credentials: RwLock<Option<Credentials>>,
    open: Mutex<Option<Open>>,
}

struct Open {
    client: Client,
    proven: bool,
}

impl ChainLine {
    /// Sends nothing yet. `visitor`: the name before there are credentials.
    pub fn new(endpoint: Endpoint, trust: Arc<KeptTrust>, visitor: ProfileName) -> Self {
        Self { endpoint, trust, visitor, credentials: RwLock::default(), open: Mutex::default() }
    }

    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    pub fn prove_by(&self, credentials: Credentials) {
        *self.credentials.write().unwrap_or_else(PoisonError::into_inner) = Some(credentials);
    }

    /// Connects if needed: tells a gateway other than the pinned one from one that does not answer.
    pub async fn meet(&self) -> Result<Agreed, GatewayError> {
        let mut open = self.open.lock().await;
        let met = match open.take() {
            Some(met) if !met.client.is_spent() => met,
            _ => self.connect().await?,
        };
        let agreed = *met.client.agreed();
        *open = Some(met);
        Ok(agreed)
    }

    /// Takes a place at the gateway by a small request.
    pub async fn probe(&self) -> Result<(), GatewayError> {
        self.relay("eth_chainId", &Value::Array(Vec::new())).await.map(drop)
    }

    async fn connect(&self) -> Result<Open, GatewayError> {
        let credentials = self.credentials.read().unwrap_or_else(PoisonError::into_inner).clone();
        let mut trust = self.trust.current();
        if let Some(credentials) = credentials {
            match Client::connect(&self.endpoint, &mut trust, &credentials).await {
                // Only its owner replaces a void key; visitors may read the chain. Other refusals in clear may be
                // forged, and one for want of room would meet a visitor first.
                Err(GatewayError::RefusedInClear(Code::Tag) | GatewayError::Refused(_)) => {
                    self.forget(&credentials);
                }
                connected => {
                    let client = connected?;
                    self.trust.learn(&trust)?;
                    return Ok(Open { client, proven: true });
                }
            }
        }
        let client = Client::visit(&self.endpoint, &mut trust, &self.visitor).await?;
        self.trust.learn(&trust)?;
        Ok(Open { client, proven: false })
    }

    fn forget(&self, void: &Credentials) {
        let mut credentials = self.credentials.write().unwrap_or_else(PoisonError::into_inner);
        credentials.take_if(|credentials| credentials == void);
    }

    async fn relay(&self, method: &str, parameters: &Value) -> Result<Relayed, GatewayError> {
        let mut slot = self.open.lock().await;
        let waiting = self.credentials.read().unwrap_or_else(PoisonError::into_inner).is_some();
        // A request abandoned halfway must not leave its answer to the next one.
        let kept = slot.take().filter(|open| !open.client.is_spent() && (open.proven || !waiting));
        let reused = kept.is_some();
        let mut open = match kept {
            Some(open) => open,
            None => self.connect().await?,
        };
        let mut relayed = open.client.relay(method, parameters).await;
        // The other end may have closed an idle connection. The chain recognises a repeated transaction.
        if reused && !goes_on(&relayed) {
            open = self.connect().await?;
            relayed = open.client.relay(method, parameters).await;
        }
        if goes_on(&relayed) {
            *slot = Some(open);
        }
        relayed
    }
}

fn goes_on(relayed: &Result<Relayed, GatewayError>) -> bool {
    match relayed {
        Ok(_) => true,
        Err(GatewayError::Refused(code)) => !code.ends_session(),
        Err(_) => false,
    }
}

#[async_trait]
impl Relay for ChainLine {
    async fn ask(&self, method: &str, parameters: Value) -> Result<Value, RelayError> {
        let silent = |error: GatewayError| RelayError::Silent(error.to_string());
        let parse = |text: &str| serde_json::from_str(text).map_err(|error| RelayError::Silent(error.to_string()));
        match self.relay(method, &parameters).await {
            Ok(Relayed::Result(result)) => parse(&result),
            Ok(Relayed::Fault { code, words, data }) => {
                let data = if data.is_empty() { None } else { Some(parse(&data)?) };
                Err(RelayError::Answered { code, message: words, data })
            }
            Err(GatewayError::Refused(Code::Method)) => Err(RelayError::NotAllowed),
            Err(error) => Err(silent(error)),
        }
    }

    fn place(&self) -> String {
        format!("the gateway {}", crate::model::clean(&self.endpoint.addresses.join(", "), 300))
    }
}
