//! Notifications to systemd for a long-running process (`sd_notify`): that it is ready, alive, or ending. None if
//! something else started it.

use std::ffi::OsStr;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

use tokio::task::JoinHandle;

/// A process reported to systemd as ready; its end is reported too.
pub struct Ready {
    beating: Option<JoinHandle<()>>,
}

/// Reports that everything requested works. From then on a keep-alive is sent twice in each period of the watchdog, as
/// long as the program's threads make progress: a peer that does not answer is no reason to be killed.
pub fn ready() -> Ready {
    say("READY=1");
    let beating = period(&variable("WATCHDOG_USEC"), &variable("WATCHDOG_PID"), std::process::id()).map(|period| {
        tokio::spawn(async move {
            loop {
                say("WATCHDOG=1");
                tokio::time::sleep(period / 2).await;
            }
        })
    });
    Ready { beating }
}

impl Drop for Ready {
    fn drop(&mut self) {
        if let Some(beating) = &self.beating {
            beating.abort();
        }
        say("STOPPING=1");
    }
}

fn variable(name: &str) -> String {
    std::env::var(name).unwrap_or_default()
}

/// The watchdog's period, if this is the process it watches.
fn period(microseconds: &str, process: &str, own: u32) -> Option<Duration> {
    let is_meant = process.is_empty() || process.parse() == Ok(own);
    let microseconds = microseconds.parse().ok().filter(|microseconds| *microseconds > 0 && is_meant)?;
    Some(Duration::from_micros(microseconds))
}

fn say(state: &str) {
    let Some(place) = std::env::var_os("NOTIFY_SOCKET").filter(|place| !place.is_empty()) else { return };
    // If systemd does not listen, the program is still useful.
    drop(send(&place, state));
}

fn send(place: &OsStr, state: &str) -> std::io::Result<usize> {
    let address = match place.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None => SocketAddr::from_pathname(place)?,
    };
    UnixDatagram::unbound()?.send_to_addr(state.as_bytes(), &address)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watchdog_of_another_process_is_not_ours() {
        assert_eq!(period("60000000", "", 7), Some(Duration::from_secs(60)));
        assert_eq!(period("60000000", "7", 7), Some(Duration::from_secs(60)));
        assert_eq!(period("60000000", "8", 7), None);
        assert_eq!((period("", "7", 7), period("0", "", 7), period("soon", "", 7)), (None, None, None));
    }

    #[test]
    fn a_socket_is_spoken_to_by_path_and_by_abstract_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("notify");
        let listening = UnixDatagram::bind(&path).expect("bound");
        let name = format!("authros-notify-{}", std::process::id());
        let abstract_one =
            UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).expect("a name")).expect("bound");
        send(path.as_os_str(), "READY=1").expect("sent");
        send(OsStr::new(&format!("@{name}")), "STOPPING=1").expect("sent");
        let mut bytes = [0; 32];
        let count = listening.recv(&mut bytes).expect("received");
        assert_eq!(&bytes[..count], b"READY=1");
        let count = abstract_one.recv(&mut bytes).expect("received");
        assert_eq!(&bytes[..count], b"STOPPING=1");
    }
}
