//! One subscriber of a topic: a bounded queue and its own writer thread, so that a slow one delays nobody.

use std::collections::VecDeque;
use std::io::Write as _;
use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// The most a queue holds, bytes; a single longer message is accepted nevertheless.
pub(super) const LONGEST_QUEUE: usize = 32 << 20;

/// A message with its length before it, shared by all that send it.
pub(super) type Frame = Arc<Vec<u8>>;

pub(super) struct Subscriber {
    pub name: String,
    stream: TcpStream,
    queue: Mutex<Queue>,
    changed: Condvar,
}

#[derive(Default)]
struct Queue {
    frames: VecDeque<Frame>,
    bytes: usize,
    /// No more frames come.
    closing: bool,
    /// Everything is sent or never will be.
    done: bool,
    /// Waiting for it was in vain; nobody waits for it until it has caught up.
    slow: bool,
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Subscriber {
    pub fn new(name: String, stream: TcpStream) -> Self {
        Self { name, stream, queue: Mutex::default(), changed: Condvar::new() }
    }

    /// Queues a frame; returns how many older ones were dropped for it, `None` if the subscriber is gone.
    pub fn push(&self, frame: &Frame) -> Option<u64> {
        let mut queue = lock(&self.queue);
        if queue.done || queue.closing {
            return None;
        }
        queue.bytes += frame.len();
        queue.frames.push_back(Arc::clone(frame));
        let mut dropped = 0;
        while queue.bytes > LONGEST_QUEUE && queue.frames.len() > 1 {
            let oldest = queue.frames.pop_front()?;
            queue.bytes -= oldest.len();
            dropped += 1;
        }
        self.changed.notify_all();
        Some(dropped)
    }

    /// Whether half of the queue's room is taken.
    pub fn is_crowded(&self) -> bool {
        let queue = lock(&self.queue);
        !queue.done && !queue.slow && queue.bytes > LONGEST_QUEUE / 2
    }

    /// Stops waiting for it if it is behind.
    pub fn outrun(&self) {
        let mut queue = lock(&self.queue);
        queue.slow |= queue.bytes > LONGEST_QUEUE / 2;
    }

    pub fn is_done(&self) -> bool {
        lock(&self.queue).done
    }

    /// Nothing queued is sent any more.
    pub fn forget(&self) {
        let mut queue = lock(&self.queue);
        queue.frames.clear();
        queue.bytes = 0;
    }

    pub fn write_all(&self) {
        while let Some(frame) = self.next() {
            if (&self.stream).write_all(&frame).is_err() {
                break;
            }
        }
        // It may be closed already.
        let _ = self.stream.shutdown(Shutdown::Both);
        lock(&self.queue).done = true;
        self.changed.notify_all();
    }

    fn next(&self) -> Option<Frame> {
        let idle = |queue: &mut Queue| queue.frames.is_empty() && !queue.closing;
        let mut queue = self.changed.wait_while(lock(&self.queue), idle).unwrap_or_else(PoisonError::into_inner);
        let frame = queue.frames.pop_front()?;
        queue.bytes -= frame.len();
        queue.slow &= queue.bytes > LONGEST_QUEUE / 4;
        Some(frame)
    }

    pub fn close(&self) {
        lock(&self.queue).closing = true;
        self.changed.notify_all();
    }

    /// Waits until everything is sent; returns how many messages were not when `deadline` came.
    pub fn wait(&self, deadline: Instant) -> u64 {
        let patience = deadline.saturating_duration_since(Instant::now());
        let waited = self.changed.wait_timeout_while(lock(&self.queue), patience, |queue| !queue.done);
        let (queue, waited) = waited.unwrap_or_else(PoisonError::into_inner);
        if waited.timed_out() {
            // Wakes the writer from a write that a hung subscriber never accepts.
            let _ = self.stream.shutdown(Shutdown::Both);
            return queue.frames.len() as u64;
        }
        0
    }
}
