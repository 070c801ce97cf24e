//! The site's wishes, read from the pipe by a thread of its own; the pipe's end is the last wish.

use std::io::Read;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

use rustdds::mio1::Waker;

use crate::Ros2Error;
use crate::pipe::read::Wish;
use crate::pipe::receive;

/// Starts reading. `None` arrives when the pipe has ended; every arrival wakes.
///
/// # Errors
/// [`Ros2Error::System`] if no thread can be started.
pub fn listen(mut from: impl Read + Send + 'static, waker: Arc<Waker>) -> Result<Receiver<Option<Wish>>, Ros2Error> {
    let (sender, receiver) = channel();
    let read = move || {
        loop {
            let wish = receive::<Wish>(&mut from).ok().flatten().map(|(wish, _)| wish);
            let ended = wish.is_none();
            if sender.send(wish).is_err() || waker.wake().is_err() || ended {
                break;
            }
        }
    };
    let started = std::thread::Builder::new().name("wishes".into()).spawn(read);
    started.map_err(|error| Ros2Error::system("start a thread", &error))?;
    Ok(receiver)
}
