//! Orders of the site, in their order, for the topics of the node.

use std::collections::BTreeMap;
use std::io::{BufWriter, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use rosrust::api::Ros;

use crate::pipe::write::{Described, Order, Report};
use crate::pipe::{PipeError, VERSION, send, write};
use crate::queue::{Queue, Taken};
use crate::{RosrustError, outlet::Outlet, told};

/// The longest wait for an order, and the longest while messages are on their way.
const BEAT: Duration = Duration::from_millis(50);
const SHORT_BEAT: Duration = Duration::from_millis(1);
const ALIVE: Duration = Duration::from_millis(500);
/// The longest wait of a topic for its subscribers, and the interval between looks.
const PATIENCE: Duration = Duration::from_secs(2);
const LOOK: Duration = Duration::from_millis(10);
const MOST_TOPICS: usize = 1024;

/// Publishes as a node until the orders end or `stop` is set. Leaves the graph on every way out.
pub fn run(
    (node, confined): (&str, bool),
    from: impl Read + Send + 'static,
    to: impl Write,
    stop: &AtomicBool,
) -> Result<(), RosrustError> {
    let mut out = BufWriter::new(to);
    let result = Child::begin(node, from, &mut out).and_then(|mut child| {
        let result = child.run(confined, stop);
        child.end();
        result
    });
    if let Err(error) = &result {
        // If the pipe itself broke, nobody hears it.
        drop(send(&mut out, &Report::Failed { reason: error.to_string() }, &[]));
    }
    drop(out.flush());
    result
}

struct Child<'a, W: Write> {
    ros: Ros,
    outlets: BTreeMap<u32, Outlet>,
    queue: Queue,
    orders: Receiver<(Order<Described>, Vec<u8>)>,
    is_leaving: bool,
    has_left: bool,
    out: &'a mut W,
}

impl<'a, W: Write> Child<'a, W> {
    fn begin(node: &str, from: impl Read + Send + 'static, out: &'a mut W) -> Result<Self, RosrustError> {
        let ros = Ros::new(node).map_err(|error| RosrustError::Join(told(&error)))?;
        let failed =
            |error: std::io::Error| RosrustError::System { action: "start a thread", reason: error.to_string() };
        let orders = write::orders(from).map_err(failed)?;
        let (outlets, queue) = (BTreeMap::new(), Queue::default());
        Ok(Self { ros, outlets, queue, orders, is_leaving: false, has_left: false, out })
    }

    fn run(&mut self, confined: bool, stop: &AtomicBool) -> Result<(), RosrustError> {
        send(self.out, &Report::Hello { version: VERSION, domain: 0, confined }, &[])?;
        let mut alive = None::<Instant>;
        loop {
            self.out.flush().map_err(PipeError::from)?;
            if !self.take_orders()? || stop.load(Ordering::Acquire) {
                return Ok(());
            }
            let Taken { messages, dropped } = self.queue.pump(&mut self.outlets);
            if messages > 0 {
                send(self.out, &Report::Taken { messages, dropped, unacknowledged: 0, unconfirmed: 0 }, &[])?;
            }
            self.leave()?;
            if alive.is_none_or(|last| last.elapsed() >= ALIVE) {
                self.look()?;
                send(self.out, &Report::Alive, &[])?;
                alive = Some(Instant::now());
            }
        }
    }

    fn look(&self) -> Result<(), RosrustError> {
        if !self.ros.is_ok() {
            return Err(RosrustError::ShutDown);
        }
        let deaf = self.outlets.values().find(|outlet| outlet.is_deaf());
        deaf.map_or(Ok(()), |deaf| Err(RosrustError::Deaf(deaf.topic.clone())))
    }

    fn take_orders(&mut self) -> Result<bool, RosrustError> {
        let waits = !self.queue.is_empty() || self.is_leaving && !self.has_left;
        let mut patience = if waits { SHORT_BEAT } else { BEAT };
        loop {
            match self.orders.recv_timeout(patience) {
                Ok((order, payload)) => self.take_order(order, payload)?,
                Err(error) => return Ok(error == RecvTimeoutError::Timeout),
            }
            patience = Duration::ZERO;
        }
    }

    fn take_order(&mut self, order: Order<Described>, payload: Vec<u8>) -> Result<(), RosrustError> {
        match order {
            Order::Advertise { writer, topic, patient, .. } => {
                let report = match self.announce(&topic, payload) {
                    Ok(outlet) => {
                        if patient {
                            self.welcome(&outlet);
                        }
                        self.outlets.insert(writer, outlet);
                        Report::Ready { writer }
                    }
                    Err(reason) => Report::Refused { writer, reason, occupied: false },
                };
                send(self.out, &report, &[])?;
            }
            Order::Publish { writer } => self.queue.push(writer, payload),
            // Cuts off its subscribers first; then the master is told.
            Order::Withdraw { writer } => drop(self.outlets.remove(&writer)),
            Order::Outrun => self.queue.outrun(&mut self.outlets),
            Order::Leave => self.is_leaving = true,
        }
        Ok(())
    }

    fn announce(&self, topic: &Described, definition: Vec<u8>) -> Result<Outlet, String> {
        if self.outlets.len() >= MOST_TOPICS {
            return Err(format!("there are already {MOST_TOPICS} topics, the limit"));
        }
        if self.outlets.values().any(|outlet| outlet.topic == topic.name) {
            return Err("the topic is already announced".to_owned());
        }
        let definition = String::from_utf8(definition).map_err(|_| "its definition is not text".to_owned())?;
        Outlet::begin(&self.ros, topic, definition)
    }

    fn welcome(&self, outlet: &Outlet) {
        let Ok(state) = self.ros.state() else { return };
        let known = state.subscribers.into_iter().find(|topic| topic.name == outlet.topic);
        let known = known.map(|topic| topic.connections).unwrap_or_default();
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            let here = outlet.subscribers();
            if known.iter().all(|name| here.contains(name)) {
                return;
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Reports once when everything has arrived.
    fn leave(&mut self) -> Result<(), RosrustError> {
        if !self.is_leaving || self.has_left || !self.queue.is_empty() {
            return Ok(());
        }
        if self.outlets.values_mut().all(Outlet::is_sent) {
            self.has_left = true;
            send(self.out, &Report::Left, &[])?;
        }
        Ok(())
    }

    /// Tells the master: the topics, then the node's log.
    fn end(&mut self) {
        self.outlets.clear();
        self.ros.shutdown_sender().shutdown();
    }
}
