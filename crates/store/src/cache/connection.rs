//! A connection to Redis. Replies are bounded before the library parses them, which would read without end.

use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Result as IoResult, Write};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use redis::{ConnectionAddr, ConnectionInfo, ConnectionLike, Pipeline, RedisError, RedisResult, Value, cmd};
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, StreamOwned};

use crate::model::header::LARGEST_BODY;

/// For connecting, and for every read and write.
pub(super) const SILENCE: Duration = Duration::from_millis(300);
/// For a request with all its replies, and TLS before it.
pub(super) const WHOLE: Duration = Duration::from_secs(1);
/// The largest record and its surroundings.
const MOST_BYTES: usize = 72 << 20;
/// Values take more memory than their bytes; a cluster lists its slots.
const MOST_VALUES: u64 = 1 << 19;
/// A cluster's slots have three levels.
const DEEPEST: usize = 8;
const LONGEST_LINE: u64 = 64 << 10;
const PIECE: u64 = 64 << 10;

const _: () = assert!(LARGEST_BODY + (4 << 20) < MOST_BYTES as u64);

pub(super) struct Connection {
    stream: BufReader<Stream>,
    database: i64,
}

enum Stream {
    Plain(Timed),
    Tls(Box<StreamOwned<ClientConnection, Timed>>),
}

/// Every read and write ends at the deadline, however the bytes trickle.
struct Timed {
    socket: Socket,
    deadline: Instant,
}

enum Socket {
    Tcp(TcpStream),
    Unix(UnixStream),
}

impl Timed {
    fn left(&self) -> IoResult<Option<Duration>> {
        let left = self.deadline.saturating_duration_since(Instant::now()).min(SILENCE);
        if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(Some(left)) }
    }
}

impl Read for Timed {
    fn read(&mut self, buffer: &mut [u8]) -> IoResult<usize> {
        let left = self.left()?;
        match &mut self.socket {
            Socket::Tcp(stream) => stream.set_read_timeout(left).and_then(|()| stream.read(buffer)),
            Socket::Unix(stream) => stream.set_read_timeout(left).and_then(|()| stream.read(buffer)),
        }
    }
}

impl Write for Timed {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        let left = self.left()?;
        match &mut self.socket {
            Socket::Tcp(stream) => stream.set_write_timeout(left).and_then(|()| stream.write(bytes)),
            Socket::Unix(stream) => stream.set_write_timeout(left).and_then(|()| stream.write(bytes)),
        }
    }

    fn flush(&mut self) -> IoResult<()> {
        Ok(())
    }
}

impl Read for Stream {
    fn read(&mut self, buffer: &mut [u8]) -> IoResult<usize> {
        match self {
            Self::Plain(stream) => stream.read(buffer),
            Self::Tls(stream) => stream.read(buffer),
        }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
        match self {
            Self::Plain(stream) => stream.write(bytes),
            Self::Tls(stream) => stream.write(bytes),
        }
    }

    fn flush(&mut self) -> IoResult<()> {
        match self {
            Self::Plain(stream) => stream.flush(),
            Self::Tls(stream) => stream.flush(),
        }
    }
}

impl Stream {
    fn open(address: &ConnectionAddr, tls: Option<&Arc<ClientConfig>>) -> IoResult<Self> {
        let deadline = Instant::now() + WHOLE;
        match address {
            ConnectionAddr::Tcp(host, port) => {
                let stream = tcp(host, *port)?;
                stream.set_nodelay(true)?;
                let timed = Timed { socket: Socket::Tcp(stream), deadline };
                let Some(tls) = tls else { return Ok(Self::Plain(timed)) };
                let name = ServerName::try_from(host.clone()).map_err(Error::other)?;
                let session = ClientConnection::new(Arc::clone(tls), name).map_err(Error::other)?;
                Ok(Self::Tls(Box::new(StreamOwned::new(session, timed))))
            }
            ConnectionAddr::Unix(path) => {
                let socket = Socket::Unix(UnixStream::connect(path)?);
                Ok(Self::Plain(Timed { socket, deadline }))
            }
            _ => Err(Error::new(ErrorKind::Unsupported, "its address is of an unknown kind")),
        }
    }

    fn begin(&mut self) {
        let timed = match self {
            Self::Plain(stream) => stream,
            Self::Tls(stream) => &mut stream.sock,
        };
        timed.deadline = Instant::now() + WHOLE;
    }
}

/// Divides the time among the addresses of the name.
fn tcp(host: &str, port: u16) -> IoResult<TcpStream> {
    let addresses: Vec<_> = (host, port).to_socket_addrs()?.collect();
    let share = SILENCE / u32::try_from(addresses.len().max(1)).unwrap_or(u32::MAX);
    let mut failure = Error::other("its name has no address");
    for address in addresses {
        match TcpStream::connect_timeout(&address, share) {
            Ok(stream) => return Ok(stream),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

impl Connection {
    pub(super) fn open(server: &ConnectionInfo, tls: Option<&Arc<ClientConfig>>) -> RedisResult<Self> {
        let stream = BufReader::new(Stream::open(server.addr(), tls)?);
        let settings = server.redis_settings();
        let mut connection = Self { stream, database: settings.db() };
        if let Some(password) = settings.password() {
            connection.sign_in(settings.username(), password)?;
        }
        if connection.database != 0 {
            cmd("SELECT").arg(connection.database).exec(&mut connection)?;
        }
        Ok(connection)
    }

    /// Servers before version 6 have no user names.
    fn sign_in(&mut self, user: Option<&str>, password: &str) -> RedisResult<()> {
        let Value::ServerError(refusal) = self.req_command(cmd("AUTH").arg(user).arg(password))? else { return Ok(()) };
        let is_old = refusal.details().is_some_and(|words| words.contains("wrong number of arguments"));
        if user.is_some() && is_old {
            return self.sign_in(None, password);
        }
        Err(RedisError::from((redis::ErrorKind::AuthenticationFailed, "it does not accept the user name and password")))
    }

    fn send(&mut self, commands: &[u8]) -> RedisResult<()> {
        let stream = self.stream.get_mut();
        stream.begin();
        stream.write_all(commands)?;
        Ok(stream.flush()?)
    }

    pub(super) fn get(&mut self, key: &str) -> RedisResult<Option<Vec<u8>>> {
        self.send(&cmd("GET").arg(key).get_packed_command())?;
        let mut reply = reply(&mut self.stream, &mut Left::default())?;
        let is_value = reply.starts_with(b"$") && !reply.starts_with(b"$-");
        // In place: the library would copy the value.
        if let Some(end) = reply.iter().position(|byte| *byte == b'\n').filter(|_| is_value) {
            reply.drain(..=end);
            reply.truncate(reply.len().saturating_sub(2));
            return Ok(Some(reply));
        }
        Ok(redis::from_redis_value(redis::parse_redis_value(&reply)?.extract_error()?)?)
    }

    /// Reads every reply, also after a refusal. The library's own pipeline reads on after a silence.
    pub(super) fn ask(&mut self, commands: &Pipeline) -> RedisResult<Vec<Value>> {
        self.send(&commands.get_packed_pipeline())?;
        self.replies(commands.len())
    }

    fn replies(&mut self, count: usize) -> RedisResult<Vec<Value>> {
        let mut left = Left::default();
        (0..count).map(|_| redis::parse_redis_value(&reply(&mut self.stream, &mut left)?)).collect()
    }
}

impl ConnectionLike for Connection {
    fn req_packed_command(&mut self, command: &[u8]) -> RedisResult<Value> {
        self.send(command)?;
        let closed = || Error::from(ErrorKind::UnexpectedEof);
        Ok(self.replies(1)?.pop().ok_or_else(closed)?)
    }

    fn req_packed_commands(&mut self, commands: &[u8], offset: usize, count: usize) -> RedisResult<Vec<Value>> {
        self.send(commands)?;
        let mut replies = self.replies(offset + count)?;
        Ok(replies.split_off(offset))
    }

    fn get_db(&self) -> i64 {
        self.database
    }

    fn check_connection(&mut self) -> bool {
        cmd("PING").exec(self).is_ok()
    }

    fn is_open(&self) -> bool {
        true
    }
}

struct Left {
    bytes: usize,
    values: u64,
}

impl Default for Left {
    fn default() -> Self {
        Self { bytes: MOST_BYTES, values: MOST_VALUES }
    }
}

impl Left {
    fn take(&mut self, bytes: u64) -> IoResult<()> {
        let rest = usize::try_from(bytes).ok().and_then(|bytes| self.bytes.checked_sub(bytes));
        self.bytes = rest.ok_or_else(|| {
            nonsense(&format!(
                "it sends more than {} MiB, longer than any reply of Redis to this program",
                MOST_BYTES >> 20
            ))
        })?;
        Ok(())
    }

    fn take_values(&mut self, values: u64) -> IoResult<()> {
        let rest = self.values.checked_sub(values);
        self.values =
            rest.ok_or_else(|| nonsense(&format!("it sends a list of {values} values, longer than any reply")))?;
        Ok(())
    }
}

fn nonsense(why: &str) -> Error {
    Error::new(ErrorKind::InvalidData, why)
}

fn reply(stream: &mut impl BufRead, left: &mut Left) -> IoResult<Vec<u8>> {
    let mut reply = Vec::new();
    // Values still to come in each array around the next one.
    let mut arrays: Vec<u64> = Vec::new();
    loop {
        let line = line(stream, left)?;
        reply.extend_from_slice(&line);
        match line.split_first() {
            Some((b'+' | b'-' | b':', _)) => {}
            Some((b'$', length)) => {
                if let Some(length) = number(length)? {
                    // With the line's end.
                    body(stream, length.saturating_add(2), left, &mut reply)?;
                }
            }
            Some((b'*', length)) => {
                let length = number(length)?.unwrap_or(0);
                left.take_values(length)?;
                if length > 0 {
                    if arrays.len() == DEEPEST {
                        return Err(nonsense("it sends lists nested deeper than any reply"));
                    }
                    arrays.push(length);
                    continue;
                }
            }
            _ => return Err(nonsense("it does not speak Redis' protocol")),
        }
        // The value ended, and perhaps arrays with it.
        loop {
            match arrays.last_mut() {
                None => return Ok(reply),
                Some(1) => {
                    arrays.pop();
                }
                Some(more) => {
                    *more -= 1;
                    break;
                }
            }
        }
    }
}

fn line(stream: &mut impl BufRead, left: &mut Left) -> IoResult<Vec<u8>> {
    let mut line = Vec::new();
    let length = stream.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line)?;
    left.take(u64::try_from(length).unwrap_or(u64::MAX))?;
    match (line.ends_with(b"\r\n"), line.len()) {
        (true, _) => Ok(line),
        (false, 0) => Err(Error::from(ErrorKind::UnexpectedEof)),
        (false, _) => Err(nonsense("it does not speak Redis' protocol")),
    }
}

/// In pieces: a false length takes no memory.
fn body(stream: &mut impl BufRead, mut length: u64, left: &mut Left, reply: &mut Vec<u8>) -> IoResult<()> {
    // Too long before any of it is read.
    if usize::try_from(length).map_or(true, |length| length > left.bytes) {
        return left.take(length);
    }
    while length > 0 {
        let read = stream.by_ref().take(length.min(PIECE)).read_to_end(reply)?;
        let read = u64::try_from(read).unwrap_or(u64::MAX);
        if read == 0 {
            return Err(Error::from(ErrorKind::UnexpectedEof));
        }
        left.take(read)?;
        length = length.saturating_sub(read);
    }
    Ok(())
}

/// `None` = -1.
fn number(line: &[u8]) -> IoResult<Option<u64>> {
    match std::str::from_utf8(line.trim_ascii_end()).unwrap_or_default() {
        "-1" => Ok(None),
        text => text.parse().map(Some).map_err(|_| nonsense("a length is not a number")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(bytes: &[u8]) -> IoResult<(Vec<u8>, usize)> {
        let mut stream = bytes;
        let mut left = Left { bytes: 1 << 20, values: 1000 };
        reply(&mut stream, &mut left).map(|reply| (reply, stream.len()))
    }

    #[test]
    fn a_reply_ends_where_it_ends() {
        for text in [
            "+OK\r\n",
            "-MOVED 1 host:1\r\n",
            ":5\r\n",
            "$-1\r\n",
            "$0\r\n\r\n",
            "$4\r\na\r\nb\r\n",
            "*-1\r\n",
            "*0\r\n",
            "*2\r\n*2\r\n:1\r\n$1\r\nx\r\n*1\r\n*0\r\n",
        ] {
            let followed = format!("{text}+NEXT\r\n");
            let (reply, rest) = cut(followed.as_bytes()).expect("a reply");
            assert_eq!((reply, rest), (text.as_bytes().to_vec(), 7), "{text}");
            assert!(redis::parse_redis_value(text.as_bytes()).is_ok(), "{text}");
            assert!(cut(&text.as_bytes()[..text.len() - 1]).is_err(), "{text}");
        }
    }

    #[test]
    fn a_reply_that_claims_too_much_is_refused_before_it_is_read() {
        let text = cut(b"$9000000000000\r\n").expect_err("too long").to_string();
        assert!(text.contains("more than 72 MiB"), "{text}");
        for bad in [
            &b"*2147483647\r\n"[..],
            b"*18446744073709551615\r\n",
            b"$18446744073709551615\r\n",
            b"*x\r\n",
            b"$-2\r\n",
            b"%1\r\n+a\r\n+b\r\n",
            b"HTTP/1.1 400 Bad Request\r\n",
            b"",
        ] {
            assert!(cut(bad).is_err(), "{}", String::from_utf8_lossy(bad));
        }
        assert!(cut(&b"*1\r\n".repeat(DEEPEST + 1)).is_err());
        assert!(cut(&[b"*1\r\n".repeat(DEEPEST), b":1\r\n".to_vec()].concat()).is_ok());
        assert!(cut(&[b"+".to_vec(), vec![b'x'; 1 << 17]].concat()).is_err(), "a line without an end");
        assert!(cut(&b"*1000\r\n".repeat(2)).is_err(), "all arrays together");
    }

    /// A server that answers every command with these bytes and then `flood` without an end.
    fn server(first: &'static [u8], flood: &'static [u8]) -> ConnectionInfo {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("binds");
        let port = listener.local_addr().expect("an address").port();
        std::thread::spawn(move || {
            for mut stream in listener.incoming().map_while(Result::ok) {
                drop(stream.read(&mut [0; 4096]));
                drop(stream.write_all(first));
                while !flood.is_empty() && stream.write_all(flood).is_ok() {}
                drop(stream.read(&mut [0; 4096]));
            }
        });
        redis::IntoConnectionInfo::into_connection_info(format!("redis://127.0.0.1:{port}/")).expect("a URL")
    }

    #[test]
    fn a_server_that_never_ends_its_reply_is_left() {
        let endless = [
            server(b"$9000000000000\r\n", &[b'0'; 4096]),
            server(b"*500000\r\n", b"$1024\r\n"),
            server(b"*500000\r\n", b"*1\r\n"),
            server(b"+", &[b'0'; 4096]),
        ];
        for info in endless {
            let mut connection = Connection::open(&info, None).expect("connects");
            let error = cmd("GET").arg("x").query::<Vec<u8>>(&mut connection).expect_err("no end");
            assert!(error.is_io_error(), "{error}");
        }
    }

    #[test]
    fn a_server_that_knows_no_user_names_gets_the_password_alone() {
        let asked = |reply| {
            let info = server(reply, b"");
            let url = info.addr().to_string();
            redis::IntoConnectionInfo::into_connection_info(format!("redis://me:word@{url}/")).expect("a URL")
        };
        assert!(Connection::open(&asked(b"+OK\r\n"), None).is_ok());
        let Err(error) = Connection::open(&asked(b"-WRONGPASS no\r\n"), None) else { panic!("signed in") };
        assert_eq!(error.kind(), redis::ErrorKind::AuthenticationFailed);
        let both = b"-ERR wrong number of arguments for 'auth' command\r\n+OK\r\n";
        assert!(Connection::open(&asked(both), None).is_ok());
    }
}
