//! Publishers for measurements: `/loadN/data` (`sensor_msgs/CompressedImage`), each a ROS node of its own, at a
//! constant rate: messages delayed by a pause of the machine are sent after it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::definitions::{COMPRESSED_IMAGE, compressed_image_definition};
use super::{FAREWELL, MOST_ROBOTS, PATIENCE, messages, outlet, wait_until};
use crate::model::Timestamp;
use crate::ros::RosError;
use crate::ros::address::{Endpoint, own_host};
use crate::ros::publisher::{Outlet, PublisherNode};

/// Length of the fields around a message's data: header, format and lengths, with a one-digit publisher.
const AROUND: usize = 4 + 8 + 4 + 13 + 4 + 4 + 4;
/// Messages prepared in advance, so that making them costs nothing.
const VARIANTS: usize = 16;

/// Running publishers; they end on drop, sending what is queued for subscribers first.
pub struct Load {
    nodes: Vec<PublisherNode>,
    outlets: Vec<Arc<Outlet>>,
    stopping: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    /// Registers `publishers` publishers at the master; nothing is sent before [`Load::begin`].
    ///
    /// # Errors
    /// [`RosError::Robots`] beyond [`MOST_ROBOTS`], and failures of master and sockets.
    pub fn start(master_uri: &str, publishers: u16) -> Result<Self, RosError> {
        if publishers > MOST_ROBOTS {
            return Err(RosError::Robots(publishers));
        }
        let master = Endpoint::parse(master_uri).ok_or_else(|| RosError::address(master_uri))?;
        let host = own_host(None, &master, Instant::now() + PATIENCE)?;
        let (mut nodes, mut outlets) = (Vec::new(), Vec::new());
        for number in 1..=publishers {
            let topic = format!("/load{number}/data");
            let outlet = Arc::new(outlet(topic, COMPRESSED_IMAGE, compressed_image_definition()));
            outlets.push(Arc::clone(&outlet));
            nodes.push(PublisherNode::start(master.clone(), &host, format!("/load{number}"), vec![outlet])?);
        }
        Ok(Self { nodes, outlets, stopping: Arc::default(), threads: Vec::new() })
    }

    /// The topics.
    pub fn topics(&self) -> Vec<String> {
        self.outlets.iter().map(|outlet| outlet.topic().to_owned()).collect()
    }

    /// How many topics have a subscriber.
    pub fn heard(&self) -> usize {
        self.outlets.iter().filter(|outlet| !outlet.links().is_empty()).count()
    }

    /// Publishes messages of `bytes` each, `period` apart on every topic, with incompressible data.
    ///
    /// # Errors
    /// If a thread cannot be started, or there is no randomness.
    pub fn begin(&mut self, bytes: usize, period: Duration) -> Result<(), RosError> {
        let data = self.data(bytes)?;
        for (index, outlet) in self.outlets.iter().enumerate() {
            let (stopping, outlet, data) = (Arc::clone(&self.stopping), Arc::clone(outlet), Arc::clone(&data));
            let number = u16::try_from(index + 1).unwrap_or(u16::MAX);
            // Spread over the period, as if by independent robots.
            let first = Instant::now() + period * u32::from(number) / u32::try_from(self.outlets.len()).unwrap_or(1);
            let work = move || publish(&outlet, &data, number, first, period, &stopping);
            let thread = std::thread::Builder::new().name("load".into()).spawn(work);
            self.threads.push(thread.map_err(|error| RosError::system("start a thread", &error))?);
        }
        Ok(())
    }

    fn data(&self, bytes: usize) -> Result<Arc<Vec<Vec<u8>>>, RosError> {
        let mut variants = vec![vec![0; bytes.saturating_sub(AROUND)]; VARIANTS];
        for variant in &mut variants {
            getrandom::fill(variant)
                .map_err(|error| RosError::system("draw random bytes", &std::io::Error::other(error.to_string())))?;
        }
        Ok(Arc::new(variants))
    }

    /// Messages published so far, and how many of them did not fit into a subscriber's queue.
    pub fn published(&self) -> (u64, u64) {
        let sum = |count: fn(&Outlet) -> u64| self.outlets.iter().map(|outlet| count(outlet)).sum();
        (sum(Outlet::published), sum(Outlet::overflowed))
    }

    /// Ends publishing; the nodes stay.
    pub fn end(&mut self) {
        self.stopping.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            // A thread that panicked leaves what it has published.
            drop(thread.join());
        }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.end();
        for node in &self.nodes {
            node.close(FAREWELL);
        }
    }
}

fn publish(outlet: &Outlet, data: &[Vec<u8>], number: u16, mut due: Instant, period: Duration, stopping: &AtomicBool) {
    let mut seq = 0u32;
    while wait_until(due, stopping) {
        let variant = &data[seq as usize % VARIANTS];
        outlet.publish(&messages::compressed_image(seq, Timestamp::now(), number, variant));
        seq = seq.wrapping_add(1);
        due += period;
    }
}
