//! The part of HTTP/1.x that XML-RPC needs: one request, one response, then the connection closes. Every read and write
//! is under one deadline; head and body are capped before they are stored.

use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Instant;

use crate::ros::address::time_left;

/// The longest head (request or status line with headers), bytes.
const LONGEST_HEAD: u64 = 16 * 1024;

/// A connection whose reads and writes all end at one deadline.
pub(super) struct Timed<'a> {
    pub stream: &'a TcpStream,
    pub deadline: Instant,
}

impl Read for Timed<'_> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        self.stream.set_read_timeout(Some(time_left(self.deadline)?))?;
        let mut stream = self.stream;
        stream.read(out).map_err(as_timeout)
    }
}

impl Write for Timed<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.set_write_timeout(Some(time_left(self.deadline)?))?;
        let mut stream = self.stream;
        stream.write(bytes).map_err(as_timeout)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn as_timeout(error: io::Error) -> io::Error {
    if error.kind() == ErrorKind::WouldBlock { io::Error::new(ErrorKind::TimedOut, "no answer in time") } else { error }
}

fn bad(reason: &'static str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, reason)
}

/// First line and body of a message. Without a length, a response ends with the connection and a request has no body.
pub(super) fn read_message(from: impl Read, most: usize, to_end: bool) -> io::Result<(String, Vec<u8>)> {
    let mut reader = BufReader::new(from);
    let mut head = reader.by_ref().take(LONGEST_HEAD);
    let first = line(&mut head)?;
    let mut length = None;
    let mut chunked = false;
    loop {
        let header = line(&mut head)?;
        let Some((name, value)) = header.split_once(':') else {
            if header.is_empty() { break } else { return Err(bad("its HTTP header is malformed")) }
        };
        if name.eq_ignore_ascii_case("content-length") {
            length = Some(value.trim().parse::<usize>().map_err(|_| bad("its HTTP length is not a number"))?);
        } else if name.eq_ignore_ascii_case("transfer-encoding") {
            chunked = value.trim().eq_ignore_ascii_case("chunked");
        }
    }
    let body = match length {
        _ if chunked => chunks(&mut reader, most)?,
        Some(length) => exactly(&mut reader, length, most)?,
        None if to_end => until_end(&mut reader, most)?,
        None => Vec::new(),
    };
    Ok((first, body))
}

fn line(from: &mut impl BufRead) -> io::Result<String> {
    let mut bytes = Vec::new();
    from.read_until(b'\n', &mut bytes)?;
    if bytes.pop() != Some(b'\n') {
        return Err(bad("its HTTP header ends early or is too long"));
    }
    String::from_utf8(bytes).map(|text| text.trim_end().to_owned()).map_err(|_| bad("its HTTP header is not text"))
}

fn exactly(from: &mut impl Read, length: usize, most: usize) -> io::Result<Vec<u8>> {
    if length > most {
        return Err(bad("its HTTP body is too long"));
    }
    let mut body = Vec::new();
    from.take(length as u64).read_to_end(&mut body)?;
    if body.len() == length { Ok(body) } else { Err(bad("its HTTP body ends early")) }
}

fn until_end(from: &mut impl Read, most: usize) -> io::Result<Vec<u8>> {
    let mut body = Vec::new();
    from.take(most as u64 + 1).read_to_end(&mut body)?;
    if body.len() > most { Err(bad("its HTTP body is too long")) } else { Ok(body) }
}

fn chunks(from: &mut impl BufRead, most: usize) -> io::Result<Vec<u8>> {
    let mut body = Vec::new();
    loop {
        let size = line(&mut from.take(LONGEST_HEAD))?;
        let digits = size.split(';').next().unwrap_or_default().trim();
        let size = usize::from_str_radix(digits, 16).map_err(|_| bad("an HTTP chunk has no size"))?;
        if size == 0 {
            return Ok(body);
        }
        body.extend(exactly(from, size, most - body.len())?);
        line(&mut from.take(2))?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &str, most: usize, to_end: bool) -> io::Result<(String, Vec<u8>)> {
        read_message(text.as_bytes(), most, to_end)
    }

    #[test]
    fn lengths_chunks_and_ends() {
        let (first, body) = read("POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabcd", 9, false).expect("length");
        assert_eq!((first.as_str(), body.as_slice()), ("POST / HTTP/1.1", b"abc".as_slice()));
        let chunked = "HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n2\r\nab\r\n1;x=y\r\nc\r\n0\r\n\r\n";
        assert_eq!(read(chunked, 3, true).expect("chunks").1, b"abc");
        assert_eq!(read("HTTP/1.0 200 OK\n\nabc", 3, true).expect("end").1, b"abc");
        assert_eq!(read("GET / HTTP/1.0\r\n\r\nabc", 3, false).expect("none").1, b"");
    }

    #[test]
    fn beyond_the_caps_and_cut_short() {
        assert!(read("P\r\nContent-Length: 4\r\n\r\nabcd", 3, false).is_err());
        assert!(read("P\r\nContent-Length: 4\r\n\r\nabc", 9, false).is_err());
        assert!(read("P\r\nContent-Length: -1\r\n\r\n", 9, false).is_err());
        assert!(read("P\n\nabcd", 3, true).is_err());
        assert!(read("P\r\ntransfer-encoding: chunked\r\n\r\n2\r\nab\r\n2\r\ncd\r\n0\r\n\r\n", 3, true).is_err());
        assert!(read(&format!("P\r\nx: {}\r\n\r\n", "y".repeat(20_000)), 9, true).is_err());
        assert!(read(&"x: y\r\n".repeat(20_000), 9, true).is_err());
    }

    proptest! {
        #[test]
        fn noise_never_panics_and_stays_under_the_cap(
            noise in "(Content-Length: |Transfer-Encoding: chunked|\r\n|\n|[0-9a-f]|.){0,40}", most in 0usize..20
        ) {
            if let Ok((_, body)) = read(&noise, most, true) {
                prop_assert!(body.len() <= most);
            }
        }
    }
}
