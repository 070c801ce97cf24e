//! The client's end over TCP. One request after the other, or several in flight with `send` and `receive`.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio::time::timeout;

use crate::allocation::{AllocationRequest, Applicant, apply};
use crate::command::{
    Answer, DeviceNotice, ErasureNotice, ErasureOutcome, Fetched, Found, GrantNotice, Inner, LARGEST_MESSAGE, Notice,
    Part, RelayCall, Relayed, Request, RevokeNotice, Speaker, Upload, signed_bytes, split,
};
use crate::crypto::{Anchor, SmKeyPair, TransportKey};
use crate::error::{Code, GatewayError, Refusal};
use crate::feed::{Feed, FeedPage};
use crate::frame::{Assembler, FrameKind, Line, LineError, Message};
use crate::hello::{Agreed, ClientHello, Context, NetworkName};
use crate::model::{Digest, ProfileName, Timestamp, Token, clean};
use crate::{command::messages::LONGEST_PARAMETERS, command::messages::MOST_DIGESTS, system_keys::SystemKeyList};
use crate::{crypto::record::check, model::wire::Wire as _, receipt::Receipt, session::Session, trust::Trust};

type Result<T, E = GatewayError> = std::result::Result<T, E>;

#[derive(Clone)]
pub struct Endpoint {
    /// Host and port; the first that answers is used.
    pub addresses: Vec<String>,
    pub context: Context,
    /// For an answer.
    pub patience: Duration,
    /// One of this machine's addresses, each of which has its own limits at a gateway; `None` = any.
    pub source: Option<IpAddr>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Credentials {
    pub name: ProfileName,
    pub key: TransportKey,
    /// The account's current token.
    pub token: Token,
}

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
}

impl Client {
    /// `trust` records what the gateway showed: save it. `RefusedInClear(Tag)` also if the gateway does not know the
    /// name or has another K_T; `Recalled` if the name was a device's, which has this K_T.
    pub async fn connect(endpoint: &Endpoint, trust: &mut Trust, credentials: &Credentials) -> Result<Self> {
        let who = (&credentials.name, Some(&credentials.key));
        let mut client = Self::open(endpoint, trust, who, credentials.token).await?;
        // Both sides hold K_T: from the pong on, large frames are accepted.
        client.ping().await?;
        client.line.decoder.raise_cap();
        Ok(client)
    }

    async fn open(endpoint: &Endpoint, trust: &mut Trust, who: Who<'_>, token: Token) -> Result<Self> {
        let mut failed = Vec::new();
        for address in &endpoint.addresses {
            let hello = timeout(endpoint.patience, hello(endpoint, address, trust, who)).await;
            let (line, agreed, session) = match hello.unwrap_or(Err(GatewayError::TimedOut)) {
                Ok(greeted) => greeted,
                Err(error) => {
                    failed.push((clean(address, 240), error));
                    continue;
                }
            };
            let (address, endpoint, passed_over) = (address.clone(), endpoint.clone(), failed);
            let (requests, assembler) = (0, Assembler::default());
            return Ok(Self { line, address, passed_over, endpoint, agreed, session, token, requests, assembler });
        }
        Err(GatewayError::of_addresses(failed))
    }

    /// Binds N to the account and gives K_T to the gateway, with a receipt. After a lost answer N may be bound to a
    /// lost key: allocating again replaces it.
    pub async fn allocate(at: &Endpoint, trust: &mut Trust, who: &Applicant<'_>) -> Result<(TransportKey, Receipt)> {
        let mut client = Self::open(at, trust, (who.name, None), Token([0; 32])).await?;
        let list = client.system_keys().await?;
        let context = at.context;
        let system_key = list.check(context, &client.agreed, Timestamp::now())?;
        let (key, body) = apply(&context, &client.agreed, &system_key, who)?;
        let request = AllocationRequest::parse(&body).map_err(GatewayError::malformed("own allocation"))?;
        let digest = request.digest(context.provider);
        let receipt = client.acknowledged(&Request::KeyAllocation(request), &[digest]).await?;
        Ok((key, receipt))
    }

    /// The network of the first address that answers, proven only by a later hello.
    pub async fn inquire(addresses: &[String], patience: Duration) -> Result<NetworkName> {
        let mut failed = Vec::new();
        for address in addresses {
            let named = timeout(patience, inquire(address, patience)).await;
            match named.unwrap_or(Err(GatewayError::TimedOut)) {
                Ok(named) => return Ok(named),
                Err(error) => failed.push((clean(address, 240), error)),
            }
        }
        Err(GatewayError::of_addresses(failed))
    }

    /// Without a transport key, to read the chain. `name` is only for the gateway's log.
    pub async fn visit(endpoint: &Endpoint, trust: &mut Trust, name: &ProfileName) -> Result<Self> {
        let mut client = Self::open(endpoint, trust, (name, None), Token([0; 32])).await?;
        // The gateway signed the hello and holds its keys: from the pong on, large frames are accepted.
        client.ping().await?;
        client.line.decoder.raise_cap();
        Ok(client)
    }

    /// Passes a JSON-RPC request to the chain; the answer is the gateway's word.
    pub async fn relay(&mut self, method: &str, parameters: &serde_json::Value) -> Result<Relayed> {
        let call = RelayCall { method: method.to_owned(), parameters: parameters.to_string() };
        if call.parameters.len() > LONGEST_PARAMETERS {
            return Err(GatewayError::TooLarge(call.parameters.len()));
        }
        let answer = self.ask(&Request::Relay(call)).await?;
        let Answer::Relayed(relayed) = answer else { return unexpected("no answer of the chain") };
        Ok(relayed)
    }

    /// That answered.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Addresses tried before that one, cleaned, and why they failed.
    pub fn passed_over(&self) -> &[(String, GatewayError)] {
        &self.passed_over
    }

    pub fn agreed(&self) -> &Agreed {
        &self.agreed
    }

    /// The session's frames or its hour are nearly used up: reconnect.
    pub fn is_spent(&self) -> bool {
        self.session.is_spent(Instant::now() + self.endpoint.patience)
    }

    pub async fn ping(&mut self) -> Result<Timestamp> {
        let Answer::Time(time) = self.ask(&Request::Ping).await? else { return unexpected("no time") };
        Ok(time)
    }

    /// Not yet checked.
    pub async fn system_keys(&mut self) -> Result<SystemKeyList> {
        let Answer::SystemKeys(bytes) = self.ask(&Request::SystemKeys).await? else { return unexpected("no list") };
        SystemKeyList::parse(&bytes).map_err(GatewayError::malformed("list of system keys"))
    }

    /// The receipt covers all of them.
    pub async fn upload(&mut self, mut uploads: Vec<Upload>) -> Result<Receipt> {
        let provider = self.endpoint.context.provider;
        let digests: Vec<Digest> = uploads.iter().map(|upload| Digest(provider.sm3(&[&upload.blob]))).collect();
        let request = match uploads.len() {
            1 => Request::Upload(uploads.remove(0)),
            _ => Request::UploadMany(uploads),
        };
        self.acknowledged(&request, &digests).await
    }

    /// At most 64 records that the session's owner had erased; returns the gateway's statement about each.
    pub async fn erase(&mut self, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>> {
        let count = erasures.len();
        match self.ask(&Request::Erase(erasures)).await? {
            Answer::Erasures(outcomes) if outcomes.len() == count => Ok(outcomes),
            _ => Err(GatewayError::Unexpected("an outcome for each erasure is missing")),
        }
    }

    /// Bytes match the digest, the signature is by the record's key. The reader must check key and anchor on the chain.
    /// `Erased` comes unchecked.
    pub async fn fetch(&mut self, digest: &Digest) -> Result<Fetched> {
        let found = self.records(std::slice::from_ref(digest)).await?.pop();
        found.unwrap_or(Err(GatewayError::Unexpected("no record")))
    }

    /// Checks the signature; proofs are up to the caller.
    pub async fn feed(&mut self, asked: &Feed) -> Result<FeedPage> {
        let (number, context) = (self.send(&Request::Feed(asked.clone())).await?, self.endpoint.context);
        let answer = self.answer_within(number, self.endpoint.patience + asked.wait).await?;
        let Answer::Feed(page) = answer else { return unexpected("no page of the feed") };
        page.verify(context.provider, &context.domain, &self.agreed.gateway_key)?;
        Ok(*page)
    }

    /// At least the first of these records. Bytes match digests, signatures are by the records' keys; the reader must
    /// check keys and anchors on the chain. `Erased` comes unchecked.
    pub async fn records(&mut self, digests: &[Digest]) -> Result<Vec<Result<Fetched>>> {
        let found = self.found(digests, true).await?;
        let each = found.into_iter().zip(digests).map(|(found, digest)| match found {
            Found::Held(record) => self.checked(record, digest),
            Found::Erased(erased) => Err(GatewayError::Erased(Box::new(erased))),
            Found::Missing(code) => Err(GatewayError::Refused(code)),
            Found::Here => Err(GatewayError::Unexpected("a record without its bytes")),
        });
        Ok(each.collect())
    }

    /// What the gateway does not have for this session, and why.
    pub async fn missing(&mut self, digests: &[Digest]) -> Result<Vec<(Digest, Code)>> {
        let mut missing = Vec::new();
        let mut left = digests;
        while !left.is_empty() {
            let found = self.found(left, false).await?;
            let (asked, rest) = left.split_at(found.len());
            missing.extend(asked.iter().zip(found).filter_map(|(digest, found)| match found {
                Found::Missing(code) => Some((*digest, code)),
                Found::Here | Found::Held(_) | Found::Erased(_) => None,
            }));
            left = rest;
        }
        Ok(missing)
    }

    async fn found(&mut self, digests: &[Digest], bytes: bool) -> Result<Vec<Found>> {
        let digests = &digests[..digests.len().min(MOST_DIGESTS)];
        match self.ask(&Request::Records(bytes, digests.to_vec())).await? {
            Answer::Records(found) if (1..=digests.len()).contains(&found.len()) => Ok(found),
            _ => Err(GatewayError::Unexpected("no records")),
        }
    }

    fn checked(&self, record: Fetched, digest: &Digest) -> Result<Fetched> {
        let provider = self.endpoint.context.provider;
        check(provider, &record.blob, &record.signature, &record.signer, Anchor::Chain(*digest))?;
        Ok(record)
    }

    /// Signed by d_C.
    pub async fn grant(&mut self, signing: &SmKeyPair, notice: GrantNotice) -> Result<Receipt> {
        self.signed(signing, &Request::Notice(Notice::Grant(notice))).await
    }

    /// Signed by d_C; takes effect immediately.
    pub async fn revoke(&mut self, signing: &SmKeyPair, notice: RevokeNotice) -> Result<Receipt> {
        self.signed(signing, &Request::Notice(Notice::Revoke(notice))).await
    }

    /// Signed by d_C: this session's name belongs to a device that is lent on the chain.
    pub async fn device(&mut self, signing: &SmKeyPair, notice: DeviceNotice) -> Result<Receipt> {
        self.signed(signing, &Request::Notice(Notice::Device(notice))).await
    }
}

/// N, and K_T if there is one.
type Who<'a> = (&'a ProfileName, Option<&'a TransportKey>);

/// A silent address must not use up the time of the others.
async fn dial(source: Option<IpAddr>, address: &str, patience: Duration) -> io::Result<TcpStream> {
    let fits = |place: &SocketAddr| source.is_none_or(|source| source.is_ipv4() == place.is_ipv4());
    let places: Vec<SocketAddr> = lookup_host(address).await?.filter(fits).collect();
    let share = patience / u32::try_from(places.len().max(1)).unwrap_or(u32::MAX);
    let mut failed = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for place in places {
        let socket = if place.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
        if let Some(source) = source {
            socket.bind(SocketAddr::new(source, 0))?;
        }
        match timeout(share, socket.connect(place)).await {
            Ok(Ok(stream)) => return Ok(stream),
            Ok(Err(error)) => failed = error,
            Err(_) => failed = io::Error::from(io::ErrorKind::TimedOut),
        }
    }
    Err(failed)
}

async fn hello(at: &Endpoint, place: &str, trust: &mut Trust, (name, key): Who<'_>) -> Result<(Line, Agreed, Session)> {
    let stream = dial(at.source, place, at.patience).await.map_err(|source| unreachable(place, source))?;
    let mut line = Line::new(stream);
    let hello = ClientHello::begin(at.context)?;
    let send = |error| line_error(place, error);
    line.send(FrameKind::Hello, &hello.encode(), at.patience).await.map_err(send)?;
    let (kind, payload) = line.frame().await.map_err(send)?;
    let hello = hello.agree(&expected(kind, payload, FrameKind::Answer)?)?;
    let agreed = *hello.agreed();
    trust.judge(&agreed)?;
    let (identify, session) = hello.identify(name, key)?;
    line.send(FrameKind::Identify, &identify, at.patience).await.map_err(send)?;
    Ok((line, agreed, session))
}

async fn inquire(address: &str, patience: Duration) -> Result<NetworkName> {
    let stream = dial(None, address, patience).await.map_err(|source| unreachable(address, source))?;
    let mut line = Line::new(stream);
    let send = |error| line_error(address, error);
    line.send(FrameKind::Inquiry, &NetworkName::INQUIRY, patience).await.map_err(send)?;
    let (kind, payload) = line.frame().await.map_err(send)?;
    let payload = expected(kind, payload, FrameKind::Network)?;
    NetworkName::parse(&payload).map_err(GatewayError::malformed("network"))
}

fn unexpected<T>(what: &'static str) -> Result<T> {
    Err(GatewayError::Unexpected(what))
}

fn unreachable(address: &str, source: std::io::Error) -> GatewayError {
    GatewayError::Unreachable { address: clean(address, 240), source }
}

fn line_error(address: &str, error: LineError) -> GatewayError {
    match error {
        LineError::Closed(None) => GatewayError::Closed,
        LineError::Closed(Some(source)) => unreachable(address, source),
        LineError::Frame(error) => GatewayError::Session(Refusal::new(Code::Length, error)),
        LineError::TooSlow => GatewayError::TimedOut,
    }
}

/// The payload of the wanted kind, or the refusal in clear.
fn expected(kind: FrameKind, payload: Vec<u8>, wanted: FrameKind) -> Result<Vec<u8>> {
    if kind == wanted {
        return Ok(payload);
    }
    if kind != FrameKind::Refusal {
        return Err(GatewayError::Unexpected("a frame of another kind"));
    }
    Err(GatewayError::RefusedInClear(Code::whole(&payload).map_err(GatewayError::malformed("refusal"))?))
}

impl Client {
    /// Returns the request's number for [`Self::receive`]. Read answers regularly: a gateway closes a connection whose
    /// peer does not read.
    pub async fn send(&mut self, request: &Request) -> Result<u32> {
        let body = request.encode();
        if body.len() > LARGEST_MESSAGE {
            return Err(GatewayError::TooLarge(body.len()));
        }
        let number = self.next_number();
        for text in split(request.command(), number, Speaker::Client(self.token), &body) {
            self.send_text(&text).await?;
        }
        Ok(number)
    }

    fn next_number(&mut self) -> u32 {
        self.requests = self.requests.wrapping_add(1);
        self.requests
    }

    async fn send_text(&mut self, text: &[u8]) -> Result<()> {
        let payload = self.session.seal(text)?;
        let sent = self.line.send(FrameKind::Transfer, &payload, self.endpoint.patience).await;
        let Err(error) = sent else { return Ok(()) };
        // The gateway may have given a reason before it closed.
        match timeout(self.endpoint.patience, self.line.frame()).await {
            Ok(Ok((kind @ FrameKind::Refusal, payload))) => expected(kind, payload, FrameKind::Transfer).map(|_| ()),
            _ => Err(line_error(&self.address, error)),
        }
    }

    /// The next answer, to any request; cancel-safe.
    pub async fn receive(&mut self, patience: Duration) -> Result<(u32, Answer)> {
        let message = timeout(patience, self.message()).await.map_err(|_| GatewayError::TimedOut)??;
        let answer = Answer::parse(message.command, &message.body).map_err(GatewayError::malformed("answer"))?;
        Ok((message.request, answer))
    }

    async fn message(&mut self) -> Result<Message<()>> {
        loop {
            let (kind, payload) = self.line.frame().await.map_err(|error| line_error(&self.address, error))?;
            let payload = expected(kind, payload, FrameKind::Transfer)?;
            let (counter, text) = self.session.open(&payload)?;
            let inner = Inner::from_gateway(&text).map_err(GatewayError::malformed("answer"))?;
            if let Some(message) = self.assembler.take(&inner, counter, |_| Ok(()))? {
                return Ok(message);
            }
        }
    }

    async fn answer_to(&mut self, request: u32) -> Result<Answer> {
        self.answer_within(request, self.endpoint.patience).await
    }

    async fn answer_within(&mut self, request: u32, patience: Duration) -> Result<Answer> {
        match self.receive(patience).await? {
            (number, _) if number != request => Err(GatewayError::Unexpected("an answer out of order")),
            (_, Answer::Refused(code)) => Err(GatewayError::Refused(code)),
            (_, Answer::Recalled(at)) => Err(GatewayError::Recalled(at)),
            (_, answer) => Ok(answer),
        }
    }

    async fn ask(&mut self, request: &Request) -> Result<Answer> {
        let number = self.send(request).await?;
        let answer = self.answer_to(number).await?;
        if answer.command() == request.command() { Ok(answer) } else { unexpected("another command") }
    }

    /// A receipt must cover exactly these digests.
    async fn acknowledged(&mut self, request: &Request, digests: &[Digest]) -> Result<Receipt> {
        let Answer::Receipt(_, receipt) = self.ask(request).await? else { return unexpected("no receipt") };
        self.verified(receipt, digests)
    }

    /// Checks that a receipt is by this gateway, for this network, over these digests.
    pub fn verified(&self, receipt: Receipt, digests: &[Digest]) -> Result<Receipt> {
        let context = &self.endpoint.context;
        receipt.verify(context.provider, &context.domain, &self.agreed.gateway_key)?;
        if receipt.digests == digests { Ok(receipt) } else { Err(GatewayError::Receipt("what was sent")) }
    }

    /// d_C signs for this very frame.
    async fn signed(&mut self, signing: &SmKeyPair, request: &Request) -> Result<Receipt> {
        let (context, command, body) = (self.endpoint.context, request.command(), request.encode());
        let digest = Digest(context.provider.sm3(&[&body]));
        let counter = self.session.next_counter();
        let signed =
            signed_bytes(&context.domain, &self.agreed.gateway, &self.agreed.session, counter, command, &digest);
        let signature = Some(context.provider.sign(&signing.secret, &signed)?);
        let (number, token) = (self.next_number(), Some(self.token));
        let inner = Inner { command, part: Part::Whole, request: number, token, signature, body: &body };
        self.send_text(&inner.encode(false)).await?;
        match self.answer_to(number).await? {
            Answer::Receipt(answered, receipt) if answered == command => self.verified(receipt, &[digest]),
            _ => Err(GatewayError::Unexpected("no receipt")),
        }
    }
}
