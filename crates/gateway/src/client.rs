//! The client's end over TCP: connects, judges the gateway, proves itself with K_T, sends commands, verifies receipts
//! and records. One request after the other, or several in flight with `send` and `receive`.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::time::{Duration, Instant};

use tokio::time::timeout;

use crate::crypto::record::check;
use crate::crypto::{Anchor, SmKeyPair, TransportKey};
use crate::model::{Digest, Hash, ProfileName, Timestamp, Token, clean};

use super::allocation::{AllocationRequest, Applicant, apply};
use super::command::relay::LONGEST_PARAMETERS;
use super::command::{
    Answer, Command, DeviceNotice, Entry, ErasureNotice, ErasureOutcome, Fetched, GrantNotice, Page, Query,
    Registration, RelayCall, Relayed, Request, RevokeNotice, Selection, Upload,
};
use super::error::GatewayError;
use super::hello::{Agreed, Context, NetworkName};
use super::line::Line;
use super::parts::Assembler;
use super::receipt::Receipt;
use super::session::Session;
use super::standings::SignedStandings;
use super::system_keys::SystemKeyList;
use super::trust::Trust;

mod exchange;

/// A gateway's addresses, and how to talk to it.
#[derive(Clone)]
pub struct Endpoint {
    /// Host and port each; the first that answers is used.
    pub addresses: Vec<String>,
    /// The network, and the crypto provider.
    pub context: Context,
    /// How long to wait for an answer.
    pub patience: Duration,
}

/// A client's credentials.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Credentials {
    /// N.
    pub name: ProfileName,
    /// K_T.
    pub key: TransportKey,
    /// A token of the account, the current one.
    pub token: Token,
}

/// A session with a gateway.
pub struct Client {
    line: Line,
    address: String,
    passed_over: Vec<(String, GatewayError)>,
    endpoint: Endpoint,
    agreed: Agreed,
    session: Session,
    token: Token,
    requests: u32,
    assembler: Assembler<()>,
    /// Events that arrived while something else was awaited.
    waiting: VecDeque<(u32, Answer)>,
}

impl Client {
    /// Connects with a transport key. `trust` records what the gateway showed: save it.
    ///
    /// # Errors
    /// [`GatewayError`]; `RefusedInClear(Tag)` also if the gateway does not know the name or has another K_T.
    pub async fn connect(
        endpoint: &Endpoint,
        trust: &mut Trust,
        credentials: &Credentials,
    ) -> Result<Self, GatewayError> {
        Self::connect_from(None, endpoint, trust, credentials).await
    }

    /// The same from one of this machine's addresses: a gateway limits each address by itself.
    ///
    /// # Errors
    /// [`GatewayError`]; `Unreachable` also if the address is not of this machine.
    pub async fn connect_from(
        source: Option<IpAddr>,
        endpoint: &Endpoint,
        trust: &mut Trust,
        credentials: &Credentials,
    ) -> Result<Self, GatewayError> {
        let who = (source, &credentials.name, Some(&credentials.key));
        let mut client = Self::open(endpoint, trust, who, credentials.token).await?;
        // Both sides hold K_T: from the pong on, large frames are accepted.
        client.ping().await?;
        client.line.raise_cap();
        Ok(client)
    }

    async fn open(
        endpoint: &Endpoint,
        trust: &mut Trust,
        who: exchange::Who<'_>,
        token: Token,
    ) -> Result<Self, GatewayError> {
        let mut failed = Vec::new();
        for address in &endpoint.addresses {
            let hello = timeout(endpoint.patience, exchange::hello(endpoint, address, trust, who)).await;
            match hello.unwrap_or(Err(GatewayError::TimedOut)) {
                Ok((line, agreed, session)) => {
                    return Ok(Self {
                        line,
                        address: address.clone(),
                        passed_over: failed,
                        endpoint: endpoint.clone(),
                        agreed,
                        session,
                        token,
                        requests: 0,
                        assembler: Assembler::new(),
                        waiting: VecDeque::new(),
                    });
                }
                Err(error) => failed.push((clean(address, 240), error)),
            }
        }
        Err(GatewayError::of_addresses(failed))
    }

    /// Allocates a transport key: binds N to the account and gives K_T to the gateway. The receipt proves it.
    ///
    /// # Errors
    /// [`GatewayError`]; then nothing is bound, or, if the answer was lost, N is bound to a key that nobody has:
    /// allocating again replaces it.
    pub async fn allocate(
        endpoint: &Endpoint,
        trust: &mut Trust,
        applicant: &Applicant<'_>,
    ) -> Result<(TransportKey, Receipt), GatewayError> {
        Self::allocate_from(None, endpoint, trust, applicant).await
    }

    /// The same from one of this machine's addresses.
    ///
    /// # Errors
    /// As [`Self::allocate`] and [`Self::connect_from`].
    pub async fn allocate_from(
        source: Option<IpAddr>,
        endpoint: &Endpoint,
        trust: &mut Trust,
        applicant: &Applicant<'_>,
    ) -> Result<(TransportKey, Receipt), GatewayError> {
        let mut client = Self::open(endpoint, trust, (source, applicant.name, None), Token([0; 32])).await?;
        let list = client.system_keys().await?;
        let context = endpoint.context;
        let system_key = list.check(context.provider, &context.domain, &client.agreed, Timestamp::now())?;
        let (key, body) = apply(&context, &client.agreed, &system_key, applicant)?;
        let request = AllocationRequest::parse(&body).map_err(GatewayError::malformed("own allocation"))?;
        let digest = request.digest(context.provider);
        let receipt = client.acknowledged(&Request::KeyAllocation(request), &[digest]).await?;
        Ok((key, receipt))
    }

    /// Has a gateway pass a registration to the chain; returns the transaction's hash.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn register(
        endpoint: &Endpoint,
        trust: &mut Trust,
        name: &ProfileName,
        registration: Registration,
    ) -> Result<Hash, GatewayError> {
        let mut client = Self::open(endpoint, trust, (None, name, None), Token([0; 32])).await?;
        match client.ask(&Request::Register(Box::new(registration))).await? {
            Answer::Registered(hash) => Ok(hash),
            _ => Err(GatewayError::Unexpected("no transaction")),
        }
    }

    /// Asks the first of these addresses that answers which network it is on. Nothing is proven yet; the hello on that
    /// network proves it.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn inquire(addresses: &[String], patience: Duration) -> Result<NetworkName, GatewayError> {
        let mut failed = Vec::new();
        for address in addresses {
            let named = timeout(patience, exchange::inquire(address, patience)).await;
            match named.unwrap_or(Err(GatewayError::TimedOut)) {
                Ok(named) => return Ok(named),
                Err(error) => failed.push((clean(address, 240), error)),
            }
        }
        Err(GatewayError::of_addresses(failed))
    }

    /// Connects without a transport key, to read the chain through the gateway. `name` is only for the gateway's log.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn visit(endpoint: &Endpoint, trust: &mut Trust, name: &ProfileName) -> Result<Self, GatewayError> {
        let mut client = Self::open(endpoint, trust, (None, name, None), Token([0; 32])).await?;
        // The gateway signed the hello and holds its keys: from the pong on, large frames are accepted.
        client.ping().await?;
        client.line.raise_cap();
        Ok(client)
    }

    /// Has the gateway pass a JSON-RPC request on to its chain. The answer is the gateway's word.
    ///
    /// # Errors
    /// [`GatewayError`]; `Refused(Stale)` if the chain does not answer.
    pub async fn relay(&mut self, method: &str, parameters: &serde_json::Value) -> Result<Relayed, GatewayError> {
        let call = RelayCall { method: method.to_owned(), parameters: parameters.to_string() };
        if call.parameters.len() > LONGEST_PARAMETERS {
            return Err(GatewayError::TooLarge(call.parameters.len()));
        }
        match self.ask(&Request::Relay(call)).await? {
            Answer::Relayed(relayed) => Ok(relayed),
            _ => Err(GatewayError::Unexpected("no answer of the chain")),
        }
    }

    /// The address at which the gateway answered.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The addresses that were tried before that one, cleaned, and why they cannot be used.
    pub fn passed_over(&self) -> &[(String, GatewayError)] {
        &self.passed_over
    }

    /// The terms agreed with the gateway.
    pub fn agreed(&self) -> &Agreed {
        &self.agreed
    }

    /// Whether it is time to reconnect: the session's frames or its hour are nearly used up.
    pub fn is_spent(&self) -> bool {
        self.session.is_spent(Instant::now() + self.endpoint.patience)
    }

    /// The gateway's time.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn ping(&mut self) -> Result<Timestamp, GatewayError> {
        match self.ask(&Request::Ping).await? {
            Answer::Time(time) => Ok(time),
            _ => Err(GatewayError::Unexpected("no time")),
        }
    }

    /// The published list, not yet checked.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn system_keys(&mut self) -> Result<SystemKeyList, GatewayError> {
        match self.ask(&Request::SystemKeys).await? {
            Answer::SystemKeys(bytes) => {
                SystemKeyList::parse(&bytes).map_err(GatewayError::malformed("list of system keys"))
            }
            _ => Err(GatewayError::Unexpected("no list")),
        }
    }

    /// Uploads records; the receipt is checked to cover all of them.
    ///
    /// # Errors
    /// [`GatewayError`]; without a receipt nothing may be discarded.
    pub async fn upload(&mut self, mut uploads: Vec<Upload>) -> Result<Receipt, GatewayError> {
        let provider = self.endpoint.context.provider;
        let digests: Vec<Digest> = uploads.iter().map(|upload| Digest(provider.sm3(&[&upload.blob]))).collect();
        let request = match uploads.len() {
            1 => Request::Upload(uploads.remove(0)),
            _ => Request::UploadMany(uploads),
        };
        self.acknowledged(&request, &digests).await
    }

    /// A page of records.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn query(&mut self, query: &Query) -> Result<Page, GatewayError> {
        match self.ask(&Request::Query(query.clone())).await? {
            Answer::Page(page) => Ok(page),
            _ => Err(GatewayError::Unexpected("no page")),
        }
    }

    /// The standings of digests, in order, signed by the gateway, with the proofs of their anchors. The signature is
    /// checked here; checking the proofs is up to the caller.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn check(&mut self, digests: &[Digest]) -> Result<SignedStandings, GatewayError> {
        let context = self.endpoint.context;
        match self.ask(&Request::Check(digests.to_vec())).await? {
            Answer::Standings(signed) => {
                signed.verify(context.provider, &context.domain, &self.agreed.gateway_key, digests)?;
                Ok(*signed)
            }
            _ => Err(GatewayError::Unexpected("no signed standings")),
        }
    }

    /// Has the gateway erase its copies of records that the session's owner had erased, at most 64; returns what becomes of
    /// each, as the gateway states it.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn erase(&mut self, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>, GatewayError> {
        let count = erasures.len();
        match self.ask(&Request::Erase(erasures)).await? {
            Answer::Erasures(outcomes) if outcomes.len() == count => Ok(outcomes),
            _ => Err(GatewayError::Unexpected("an outcome for each erasure is missing")),
        }
    }

    /// A record; its bytes match that digest, and its signature is by the key that came with it. The reader must check
    /// on the chain whether that key may sign for the owner and whether the anchor holds.
    ///
    /// # Errors
    /// [`GatewayError`]; `Erased`, with nothing of it checked, if its owner had it erased.
    pub async fn fetch(&mut self, digest: &Digest) -> Result<Fetched, GatewayError> {
        match self.ask(&Request::Fetch(*digest)).await? {
            Answer::Record(record) => self.checked(*record, digest),
            Answer::Erased(erased) => Err(GatewayError::Erased(erased)),
            _ => Err(GatewayError::Unexpected("no record")),
        }
    }

    fn checked(&self, record: Fetched, digest: &Digest) -> Result<Fetched, GatewayError> {
        let provider = self.endpoint.context.provider;
        check(provider, &record.blob, &record.signature, &record.signer, Anchor::Chain(*digest))?;
        Ok(record)
    }

    /// Subscribes; returns the number of the subscription.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn subscribe(&mut self, selection: &Selection) -> Result<u32, GatewayError> {
        let request = self.send(&Request::Subscribe(selection.clone())).await?;
        match self.answer_to(request).await? {
            Answer::Done(Command::Subscribe) => Ok(request),
            _ => Err(GatewayError::Unexpected("no subscription")),
        }
    }

    /// The next record of any subscription, checked like [`Self::fetch`]; `Err(Refused)` if one ended.
    ///
    /// # Errors
    /// [`GatewayError::TimedOut`] if none came within `patience`; nothing is lost then.
    pub async fn next_event(&mut self, patience: Duration) -> Result<(u32, Entry, Fetched), GatewayError> {
        let found = self.waiting.iter().position(|(_, answer)| matches!(answer, Answer::Event(_) | Answer::End(_)));
        let next = match found.and_then(|index| self.waiting.remove(index)) {
            Some(next) => next,
            None => self.receive(patience).await?,
        };
        match next {
            (request, Answer::Event(event)) => {
                let (entry, record) = *event;
                Ok((request, entry, self.checked(record, &entry.digest)?))
            }
            (_, Answer::End(code)) => Err(GatewayError::Refused(code)),
            _ => Err(GatewayError::Unexpected("an answer instead of a record")),
        }
    }

    /// Ends a subscription; records already in flight may still arrive.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn unsubscribe(&mut self, subscription: u32) -> Result<(), GatewayError> {
        match self.ask(&Request::Unsubscribe(subscription)).await? {
            Answer::Done(Command::Unsubscribe) => Ok(()),
            _ => Err(GatewayError::Unexpected("no end of the subscription")),
        }
    }

    /// Tells the gateway of a grant, signed by d_C.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn grant(&mut self, signing: &SmKeyPair, notice: GrantNotice) -> Result<Receipt, GatewayError> {
        self.signed(signing, &Request::GrantNotice(notice)).await
    }

    /// Tells the gateway of a revoke, signed by d_C: it applies at once.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn revoke(&mut self, signing: &SmKeyPair, notice: RevokeNotice) -> Result<Receipt, GatewayError> {
        self.signed(signing, &Request::RevokeNotice(notice)).await
    }

    /// Tells the gateway, signed by d_C, that this session's name belongs to a device that is lent on the chain.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn device(&mut self, signing: &SmKeyPair, notice: DeviceNotice) -> Result<Receipt, GatewayError> {
        self.signed(signing, &Request::DeviceNotice(notice)).await
    }
}
