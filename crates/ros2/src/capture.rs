//! The loop over graph, wishes and samples. The end of the pipe is the last wish.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufWriter, ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

use rustdds::discovery::DiscoveredWriterData;
use rustdds::mio1::{Events, Poll, Token, Waker};

use crate::graph::{self, Graph, Nodes, Prefix};
use crate::member::{Member, OVERLAP};
use crate::pipe::read::{Told, Wish};
use crate::pipe::{LONGEST_PAYLOAD, VERSION, receive, send};
use crate::reading::{Bringer, Lines};
use crate::reading::{Reading, Subject, Taken};
use crate::{Ros2Error, describing::Question, member};

const WAKE: Token = Token(0);
/// The first reader's; 1 is the participants'.
const FIRST: usize = 2;

const BEAT: Duration = Duration::from_millis(100);
const LOOK: Duration = Duration::from_secs(1);
const ALIVE: Duration = Duration::from_millis(500);
/// Endpoints of others after which the participant is replaced: rustdds keeps about 700 bytes of each, 3 MiB by then,
/// and frees them only with the participant. Finding a domain again costs seconds, in a large one more: there it takes
/// four times as many as there are writers, about twice as many as there are endpoints.
const RENEW_AFTER: usize = 4096;
const OF_A_LARGE_DOMAIN: usize = 4;
/// The longest overlap of two participants. The successor waits for nodes that were killed: Fast DDS drops them after
/// 20 s.
const LONGEST_OVERLAP: Duration = Duration::from_secs(30);
/// Time to leave the domain before the process ends anyway.
const LEAVING: Duration = Duration::from_secs(2);
const MOST_TOPICS: usize = 4096;

/// Reads `domain` until the wishes end or `stop` is set. Leaves the domain on every way out. Its participant is
/// replaced after meeting `renew_after` endpoints of others; by default, before they cost too much memory.
pub fn run(
    (domain, confined): (u16, bool),
    renew_after: Option<usize>,
    from: impl Read + Send + 'static,
    to: impl Write,
    stop: &AtomicBool,
) -> Result<(), Ros2Error> {
    let mut out = BufWriter::with_capacity(256 << 10, to);
    send(&mut out, &Told::Hello { version: VERSION, domain, confined }, &[])?;
    out.flush().map_err(crate::pipe::PipeError::from)?;
    let result = Child::begin((domain, renew_after), from, &mut out).and_then(|mut child| {
        let result = child.joined().and_then(|()| child.run(stop));
        child.members.iter().for_each(|member| member.farewell.say());
        leave_soon();
        result
    });
    if let Err(error) = &result {
        // If the pipe itself broke, nobody hears it.
        drop(send(&mut out, &Told::Failed { reason: error.to_string() }, &[]));
    }
    drop(out.flush());
    result
}

pub(crate) fn leave_soon() {
    let end = || {
        std::thread::sleep(LEAVING);
        std::process::exit(3);
    };
    drop(std::thread::Builder::new().name("leaving".into()).spawn(end));
}

struct Child<'a, W: Write> {
    /// Its participant, and for a while the successor behind it.
    members: Vec<Member>,
    lines: Lines,
    renew_after: Option<usize>,
    domain: u16,
    poll: Poll,
    wishes: Receiver<Wish>,
    wanted: BTreeSet<String>,
    refused: BTreeSet<String>,
    graph: Graph,
    nodes: Nodes,
    next: usize,
    out: &'a mut W,
}

impl<'a, W: Write> Child<'a, W> {
    fn begin(
        (domain, renew_after): (u16, Option<usize>),
        from: impl Read + Send + 'static,
        out: &'a mut W,
    ) -> Result<Self, Ros2Error> {
        let system = |error: std::io::Error| Ros2Error::system("wait for events", &error);
        let poll = Poll::new().map_err(system)?;
        let waker = Arc::new(Waker::new(poll.registry(), WAKE).map_err(system)?);
        let wishes = listen(from, waker)?;
        let member = Member::join(domain, poll.registry())?;
        let mut graph = Graph::default();
        graph.joined(member.prefix());
        Ok(Self {
            members: vec![member],
            lines: Lines::default(),
            renew_after,
            domain,
            poll,
            wishes,
            wanted: BTreeSet::new(),
            refused: BTreeSet::new(),
            graph,
            nodes: Nodes::default(),
            next: FIRST,
            out,
        })
    }

    /// The site says farewell for a killed child.
    fn joined(&mut self) -> Result<(), Ros2Error> {
        let participants = self.members.iter().map(|member| graph::hex(&member.prefix())).collect();
        send(self.out, &Told::Joined { participants }, &[])?;
        Ok(())
    }

    fn run(&mut self, stop: &AtomicBool) -> Result<(), Ros2Error> {
        let mut events = Events::with_capacity(256);
        let (mut looked, mut alive) = (None::<Instant>, None::<Instant>);
        let due = |last: Option<Instant>, every| last.is_none_or(|last| last.elapsed() >= every);
        loop {
            self.wait(&mut events)?;
            if stop.load(Ordering::Acquire) {
                return Ok(());
            }
            let mut changed = self.members.iter().any(|member| !member.is_fitted);
            self.members.iter_mut().for_each(|member| changed |= member.listen());
            let Some(new) = self.take_wishes() else { return Ok(()) };
            changed |= new;
            if changed || due(looked, LOOK) {
                // A lost notification costs no more than this.
                self.members.iter_mut().flat_map(|member| member.readings.values_mut()).for_each(|it| it.ready = true);
                self.look()?;
                looked = Some(Instant::now());
            }
            self.take()?;
            for member in &mut self.members {
                for (told, text) in member.go_on(&self.graph) {
                    send(self.out, &told, &text)?;
                }
            }
            self.renew()?;
            if due(alive, ALIVE) {
                if !member::threads_run(self.members.len()) {
                    return Err(Ros2Error::Threads);
                }
                send(self.out, &Told::Alive(self.graph.counts(self.present().len())), &[])?;
                alive = Some(Instant::now());
            }
            self.out.flush().map_err(crate::pipe::PipeError::from)?;
        }
    }

    fn wait(&mut self, events: &mut Events) -> Result<(), Ros2Error> {
        let more = self.members.iter().flat_map(|member| member.readings.values()).any(|reading| reading.ready);
        match self.poll.poll(events, Some(if more { Duration::ZERO } else { BEAT })) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::Interrupted => return Ok(()),
            Err(error) => return Err(Ros2Error::system("wait for events", &error)),
        }
        for event in &*events {
            let found = self.members.iter_mut().find_map(|member| member.readings.get_mut(&event.token().0));
            found.into_iter().for_each(|reading| reading.ready = true);
        }
        Ok(())
    }

    /// Whether there were new wishes; `None` if no more will come.
    fn take_wishes(&mut self) -> Option<bool> {
        let mut changed = false;
        loop {
            match self.wishes.try_recv() {
                Ok(Wish::Watch { topic }) if self.wanted.len() < MOST_TOPICS => {
                    self.wanted.insert(topic);
                }
                Ok(Wish::Watch { .. }) => {}
                Ok(Wish::Describe { node, type_name, type_hash }) => {
                    if let Some(newest) = self.members.last_mut() {
                        newest.describing.ask(Question { node, type_name, type_hash });
                    }
                }
                Ok(Wish::Unwatch { topic }) => {
                    self.wanted.remove(&topic);
                    self.refused.remove(&topic);
                }
                Err(TryRecvError::Empty) => return Some(changed),
                Err(TryRecvError::Disconnected) => return None,
            }
            changed = true;
        }
    }

    /// Writers of others, as our staying participants know them.
    fn writers(&mut self) -> Vec<DiscoveredWriterData> {
        let (mut all, mut newest) = (BTreeMap::new(), 0);
        for member in self.members.iter_mut().filter(|member| !member.leaves) {
            let mut found = member.writers();
            found.retain(|writer| !self.graph.is_own(&graph::prefix(&writer.publication_topic_data.key.to_bytes())));
            newest = found.len();
            all.extend(found.into_iter().map(|writer| (writer.publication_topic_data.key, writer)));
        }
        if let Some(member) = self.members.last_mut() {
            member.complete = (newest == all.len()).then(|| member.complete.unwrap_or_else(Instant::now));
        }
        all.into_values().collect()
    }

    /// The participants of others.
    fn present(&self) -> BTreeSet<Prefix> {
        let seen = self.members.iter().flat_map(|member| &member.participants);
        seen.copied().filter(|participant| !self.graph.is_own(participant)).collect()
    }

    /// Reports changes of the graph, and adapts the readers to it.
    fn look(&mut self) -> Result<(), Ros2Error> {
        let writers = self.writers();
        for told in self.graph.look(&writers, &self.nodes) {
            send(self.out, &told, &[])?;
        }
        let present = self.present();
        self.nodes.keep(|participant| present.contains(participant));
        let wanted: BTreeSet<String> =
            self.wanted.iter().map(|topic| graph::dds_topic(topic)).chain([graph::NODES.to_owned()]).collect();
        self.lines.keep(|writer| self.graph.is_of_any(writer, &wanted));
        let (mut refused, nothing) = (Vec::new(), BTreeSet::new());
        for member in &mut self.members {
            let wanted = if member.leaves { &nothing } else { &wanted };
            refused.extend(member.fit(wanted, &self.graph, (self.poll.registry(), &mut self.next)));
        }
        refused.into_iter().try_for_each(|(dds_topic, error)| self.refuse(&dds_topic, &error))
    }

    /// Replaces a participant that met too many endpoints: its successor reads beside it, and takes over each writer's
    /// messages before it leaves.
    fn renew(&mut self) -> Result<(), Ros2Error> {
        let after = self.renew_after.unwrap_or(RENEW_AFTER.max(OF_A_LARGE_DOMAIN * self.graph.writers.len()));
        match self.members.as_mut_slice() {
            [only] if only.met >= after => {
                only.met = 0;
                // Where a second one cannot join, the first goes on.
                if let Ok(mut successor) = Member::join(self.domain, self.poll.registry()) {
                    successor.describing = only.describing.hand_on();
                    self.graph.joined(successor.prefix());
                    self.members.push(successor);
                    self.joined()?;
                    self.look()?;
                }
            }
            [former, successor] if !former.leaves => {
                let is_late = successor.begun.elapsed() >= LONGEST_OVERLAP;
                let is_found = successor.complete.is_some_and(|since| since.elapsed() >= OVERLAP);
                if is_late || is_found && self.lines.are_handed_over() {
                    former.leaves = true;
                    let mut passing = Vec::new();
                    self.lines.end(&mut passing);
                    self.pass_on(&mut passing)?;
                    self.look()?;
                }
            }
            [former, successor] if former.has_left() => {
                successor.met = 0;
                let former = self.members.remove(0);
                former.farewell.say();
                // In a thread: it takes a moment, in which messages would wait.
                drop(std::thread::Builder::new().name("former".into()).spawn(move || drop(former)));
                self.joined()?;
            }
            _ => {}
        }
        Ok(())
    }

    fn refuse(&mut self, dds_topic: &str, error: &Ros2Error) -> Result<(), Ros2Error> {
        let Some(topic) = graph::topic(dds_topic) else { return Ok(()) };
        if self.refused.insert(topic.clone()) {
            let reason: String = error.to_string().chars().take(500).collect();
            send(self.out, &Told::Refused { topic, reason }, &[])?;
        }
        Ok(())
    }

    /// Gives one turn to every topic with samples.
    fn take(&mut self) -> Result<(), Ros2Error> {
        let (mut taken, mut passing, mut nodes_changed) = (Vec::new(), Vec::new(), false);
        let members = self.members.iter().enumerate();
        let all = members.flat_map(|(place, member)| member.readings.iter().map(move |reading| (place, reading)));
        let ready = all.filter(|(_, (_, reading))| reading.ready);
        let ready: Vec<(usize, usize)> = ready.map(|(place, (key, _))| (place, *key)).collect();
        for (place, key) in ready {
            let kept = self.members.iter().flat_map(|member| member.readings.values()).map(Reading::kept).sum();
            let Some(member) = self.members.get_mut(place) else { continue };
            let Some(subject) = member.take(key, kept, &mut taken) else { continue };
            let bringer = match self.members.as_slice() {
                [former, _] if former.leaves => Bringer::Only,
                [_, _] if place == 0 => Bringer::Former,
                [_, _] => Bringer::Successor,
                _ => Bringer::Only,
            };
            if subject.dds_topic == graph::NODES {
                taken.drain(..).for_each(|sample| self.nodes.take(&sample.writer, &sample.bytes));
                nodes_changed = true;
                continue;
            }
            for sample in taken.drain(..) {
                if self.is_announced(&sample, &subject)? {
                    self.lines.follow(sample, bringer, &mut passing);
                }
            }
            self.pass_on(&mut passing)?;
        }
        if nodes_changed { self.look() } else { Ok(()) }
    }

    /// Announces the sample's writer to the site; whether the sample can be passed on.
    fn is_announced(&mut self, sample: &Taken, subject: &Subject) -> Result<bool, Ros2Error> {
        if !self.graph.known.contains(&sample.writer) {
            let writers = self.writers();
            let told = self.graph.look(&writers, &self.nodes);
            let by_sample = !self.graph.known.contains(&sample.writer);
            let (topic, type_name) = (&subject.dds_topic, &subject.dds_type);
            let by_sample = by_sample.then(|| self.graph.by_sample(sample.writer, topic, type_name)).flatten();
            for told in told.into_iter().chain(by_sample) {
                send(self.out, &told, &[])?;
            }
        }
        let is_short = sample.bytes.len() <= LONGEST_PAYLOAD as usize;
        if !is_short {
            let reason = format!("a message of {} bytes exceeds the limit of {LONGEST_PAYLOAD}", sample.bytes.len());
            self.refuse(&subject.dds_topic, &Ros2Error::System { action: "take a message", reason })?;
        }
        Ok(is_short)
    }

    fn pass_on(&mut self, passing: &mut Vec<Taken>) -> Result<(), Ros2Error> {
        for Taken { writer, number, sent, arrived, bytes } in passing.drain(..) {
            send(self.out, &Told::Sample { writer: graph::hex(&writer), number, sent, arrived }, &bytes)?;
        }
        Ok(())
    }
}

/// Every arrival wakes, and so does the end of the pipe.
fn listen(mut from: impl Read + Send + 'static, waker: Arc<Waker>) -> Result<Receiver<Wish>, Ros2Error> {
    let (sender, receiver) = channel();
    let read = move || {
        while let Ok(Some((wish, _))) = receive(&mut from)
            && sender.send(wish).is_ok()
            && waker.wake().is_ok()
        {}
        drop(sender);
        drop(waker.wake());
    };
    let started = std::thread::Builder::new().name("wishes".into()).spawn(read);
    started.map_err(|error| Ros2Error::system("start a thread", &error))?;
    Ok(receiver)
}
