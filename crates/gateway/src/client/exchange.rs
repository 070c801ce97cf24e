//! How a client's requests and the gateway's answers are sent and received.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use tokio::net::{TcpSocket, TcpStream, lookup_host};
use tokio::time::timeout;

use crate::crypto::{SmKeyPair, TransportKey};
use crate::gateway::code::{Code, Refusal};
use crate::gateway::command::answer::read_code;
use crate::gateway::command::{Answer, Inner, LARGEST_MESSAGE, Part, Request, Speaker, signed_bytes, split};
use crate::gateway::error::GatewayError;
use crate::gateway::frame::FrameKind;
use crate::gateway::hello::{Agreed, ClientHello, NetworkName};
use crate::gateway::line::{Line, LineError};
use crate::gateway::parts::Message;
use crate::gateway::receipt::Receipt;
use crate::gateway::session::Session;
use crate::gateway::trust::Trust;
use crate::model::wire::Reader;
use crate::model::{Digest, ProfileName, clean};

use super::{Client, Endpoint};

/// The most events that wait for a reader while an answer is awaited.
const MOST_WAITING: usize = 64;

/// Who connects: from which of this machine's addresses (`None` = whichever fits), N, and K_T if there is one.
pub(super) type Who<'a> = (Option<IpAddr>, &'a ProfileName, Option<&'a TransportKey>);

/// Each address of a name gets its share of the time: one that is silent must not use up that of the others.
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

/// Connects and agrees on a session.
pub(super) async fn hello(
    endpoint: &Endpoint,
    address: &str,
    trust: &mut Trust,
    (source, name, key): Who<'_>,
) -> Result<(Line, Agreed, Session), GatewayError> {
    let stream = dial(source, address, endpoint.patience).await.map_err(|source| unreachable(address, source))?;
    let mut line = Line::new(stream);
    let hello = ClientHello::begin(endpoint.context)?;
    let send = |error| line_error(address, error);
    line.send(FrameKind::Hello, &hello.encode(), endpoint.patience).await.map_err(send)?;
    let (kind, payload) = line.frame().await.map_err(send)?;
    let hello = hello.agree(&expected(kind, payload, FrameKind::Answer)?)?;
    let agreed = *hello.agreed();
    trust.judge(&agreed)?;
    let (identify, session) = hello.identify(name, key)?;
    line.send(FrameKind::Identify, &identify, endpoint.patience).await.map_err(send)?;
    Ok((line, agreed, session))
}

/// The network at an address.
pub(super) async fn inquire(address: &str, patience: Duration) -> Result<NetworkName, GatewayError> {
    let stream = dial(None, address, patience).await.map_err(|source| unreachable(address, source))?;
    let mut line = Line::new(stream);
    let send = |error| line_error(address, error);
    line.send(FrameKind::Inquiry, &NetworkName::INQUIRY, patience).await.map_err(send)?;
    let (kind, payload) = line.frame().await.map_err(send)?;
    let payload = expected(kind, payload, FrameKind::Network)?;
    NetworkName::parse(&payload).map_err(GatewayError::malformed("network"))
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

/// The payload of a frame of the expected kind, or the reason given in clear why there is none.
fn expected(kind: FrameKind, payload: Vec<u8>, wanted: FrameKind) -> Result<Vec<u8>, GatewayError> {
    if kind == wanted {
        return Ok(payload);
    }
    if kind != FrameKind::Refusal {
        return Err(GatewayError::Unexpected("a frame of another kind"));
    }
    let mut reader = Reader::new(&payload);
    let code = read_code(&mut reader).and_then(|code| reader.end().map(|()| code));
    Err(GatewayError::RefusedInClear(code.map_err(GatewayError::malformed("refusal"))?))
}

impl Client {
    /// Sends a request and returns its number; [`Self::receive`] returns the answer. Read answers regularly: a gateway
    /// closes a connection whose peer does not read.
    ///
    /// # Errors
    /// [`GatewayError`].
    pub async fn send(&mut self, request: &Request) -> Result<u32, GatewayError> {
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

    async fn send_text(&mut self, text: &[u8]) -> Result<(), GatewayError> {
        let payload = self.session.seal(text)?;
        let sent = self.line.send(FrameKind::Transfer, &payload, self.endpoint.patience).await;
        let Err(error) = sent else { return Ok(()) };
        // The gateway may have given a reason before it closed.
        match timeout(self.endpoint.patience, self.line.frame()).await {
            Ok(Ok((kind @ FrameKind::Refusal, payload))) => expected(kind, payload, FrameKind::Transfer).map(|_| ()),
            _ => Err(line_error(&self.address, error)),
        }
    }

    /// The next answer or event, for any request. Can be cancelled at any point.
    ///
    /// # Errors
    /// [`GatewayError::TimedOut`] if nothing came within `patience`; nothing is lost then.
    pub async fn receive(&mut self, patience: Duration) -> Result<(u32, Answer), GatewayError> {
        let message = timeout(patience, self.message()).await.map_err(|_| GatewayError::TimedOut)??;
        let answer = Answer::parse(message.command, &message.body).map_err(GatewayError::malformed("answer"))?;
        Ok((message.request, answer))
    }

    async fn message(&mut self) -> Result<Message<()>, GatewayError> {
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

    /// The answer to a request; events that arrive before it are queued.
    pub(super) async fn answer_to(&mut self, request: u32) -> Result<Answer, GatewayError> {
        loop {
            match self.receive(self.endpoint.patience).await? {
                event @ (_, Answer::Event(_) | Answer::End(_)) => {
                    if self.waiting.len() >= MOST_WAITING {
                        return Err(GatewayError::Unexpected("an endless stream of events"));
                    }
                    self.waiting.push_back(event);
                }
                (number, _) if number != request => return Err(GatewayError::Unexpected("an answer out of order")),
                (_, Answer::Refused(code)) => return Err(GatewayError::Refused(code)),
                (_, answer) => return Ok(answer),
            }
        }
    }

    pub(super) async fn ask(&mut self, request: &Request) -> Result<Answer, GatewayError> {
        let number = self.send(request).await?;
        let answer = self.answer_to(number).await?;
        if answer.command() == request.command() {
            Ok(answer)
        } else {
            Err(GatewayError::Unexpected("another command"))
        }
    }

    /// Sends a request that is acknowledged by a receipt over exactly these digests.
    pub(super) async fn acknowledged(
        &mut self,
        request: &Request,
        digests: &[Digest],
    ) -> Result<Receipt, GatewayError> {
        match self.ask(request).await? {
            Answer::Receipt(_, receipt) => self.verified(receipt, digests),
            _ => Err(GatewayError::Unexpected("no receipt")),
        }
    }

    /// Checks a receipt returned by [`Self::receive`]: by this gateway, for this network, over these digests.
    ///
    /// # Errors
    /// [`GatewayError::Receipt`] or [`GatewayError::Crypto`].
    pub fn verified(&self, receipt: Receipt, digests: &[Digest]) -> Result<Receipt, GatewayError> {
        let context = &self.endpoint.context;
        receipt.verify(context.provider, &context.domain, &self.agreed.gateway_key)?;
        if receipt.digests == digests { Ok(receipt) } else { Err(GatewayError::Receipt("what was sent")) }
    }

    /// Sends a signed Command: d_C signs for this very frame.
    pub(super) async fn signed(&mut self, signing: &SmKeyPair, request: &Request) -> Result<Receipt, GatewayError> {
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
