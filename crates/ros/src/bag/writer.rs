//! Writes a bag: chunks of about 768 KiB, each with its index; the connections and the chunks' positions at the end.

use std::collections::{BTreeMap, HashMap};
use std::io::{Seek, SeekFrom, Write};
use std::sync::Arc;

use super::MAGIC;
use super::record::{Op, put_connection, put_fields, put_length, time_bytes};
use crate::model::Timestamp;
use crate::ros::RosError;
use crate::ros::recording::{
    CHUNK_THRESHOLD, Channel, ChunkCompression, Encoding, LARGEST_CHUNK, MOST_CHANNELS, RecordingFormat, pack,
};
use crate::ros::tcpros::LONGEST_MESSAGE;

/// The bag's header with its padding, without lengths.
const HEADER_LENGTH: usize = 4096;

/// The position of a chunk and what it holds.
#[derive(Debug)]
struct ChunkInfo {
    position: u64,
    span: (Timestamp, Timestamp),
    counts: Vec<(u32, u32)>,
}

/// Writes a bag of version 2.0.
#[derive(Debug)]
pub struct BagWriter<W> {
    out: W,
    position: u64,
    compression: ChunkCompression,
    numbers: HashMap<Arc<Channel>, u32>,
    connections: Vec<Arc<Channel>>,
    chunk: Vec<u8>,
    span: Option<(Timestamp, Timestamp)>,
    /// Time and offset of each message of the chunk, by connection.
    index: BTreeMap<u32, Vec<(Timestamp, usize)>>,
    chunks: Vec<ChunkInfo>,
}

impl<W: Write + Seek> BagWriter<W> {
    /// Starts a bag.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be written, or bags do not use this compression.
    pub fn begin(out: W, compression: ChunkCompression) -> Result<Self, RosError> {
        if !RecordingFormat::Bag.takes(compression) {
            return Err(RosError::recording(&format!("a bag cannot be compressed with {compression}")));
        }
        let mut writer = Self {
            out,
            position: 0,
            compression,
            numbers: HashMap::new(),
            connections: Vec::new(),
            chunk: Vec::new(),
            span: None,
            index: BTreeMap::new(),
            chunks: Vec::new(),
        };
        writer.put(MAGIC)?;
        writer.put(&bag_header(0, 0, 0))?;
        Ok(writer)
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), RosError> {
        self.out.write_all(bytes).map_err(|error| RosError::unwritable(&error))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Writes one message; its time is kept to the nanosecond.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be written, is too large, or is not a ROS 1 message.
    pub fn write(&mut self, channel: &Arc<Channel>, time: Timestamp, body: &[u8]) -> Result<(), RosError> {
        if channel.encoding != Encoding::Ros1 {
            return Err(RosError::recording("a bag can only hold ROS 1 messages; write MCAP instead"));
        }
        if body.len() > LONGEST_MESSAGE || time.0 / 1_000_000_000 > u64::from(u32::MAX) {
            return Err(RosError::recording("a message is too large, or its time does not fit into a bag"));
        }
        let number = self.number(channel)?;
        self.index.entry(number).or_default().push((time, self.chunk.len()));
        let (first, last) = self.span.unwrap_or((time, time));
        self.span = Some((first.min(time), last.max(time)));
        let conn = number.to_le_bytes();
        put_fields(&mut self.chunk, &[("op", &[Op::Message as u8]), ("conn", &conn), ("time", &time_bytes(time))]);
        put_length(&mut self.chunk, body.len());
        self.chunk.extend_from_slice(body);
        if self.chunk.len() >= CHUNK_THRESHOLD { self.end_chunk() } else { Ok(()) }
    }

    /// The number of a connection; the record of a new one goes into the chunk first.
    fn number(&mut self, channel: &Arc<Channel>) -> Result<u32, RosError> {
        if let Some(number) = self.numbers.get(channel) {
            return Ok(*number);
        }
        if self.connections.len() >= MOST_CHANNELS {
            return Err(RosError::recording(&format!("a bag cannot hold more than {MOST_CHANNELS} connections")));
        }
        let number = u32::try_from(self.connections.len()).unwrap_or(u32::MAX);
        self.numbers.insert(Arc::clone(channel), number);
        self.connections.push(Arc::clone(channel));
        put_connection(&mut self.chunk, number, channel);
        Ok(number)
    }

    fn end_chunk(&mut self) -> Result<(), RosError> {
        let Some(span) = self.span.take() else { return Ok(()) };
        debug_assert!(self.chunk.len() <= LARGEST_CHUNK, "a message and less than the threshold before it");
        let size = self.chunk.len();
        let packed = pack(self.compression, &self.chunk).map_err(|error| RosError::recording(&error))?;
        let position = self.position;
        let mut head = Vec::with_capacity(64);
        let size = u32::try_from(size).unwrap_or(u32::MAX).to_le_bytes();
        let compression = self.compression.word().as_bytes();
        put_fields(&mut head, &[("op", &[Op::Chunk as u8]), ("compression", compression), ("size", &size)]);
        put_length(&mut head, packed.len());
        self.put(&head)?;
        self.put(&packed)?;
        let index = std::mem::take(&mut self.index);
        let mut counts = Vec::with_capacity(index.len());
        for (number, entries) in index {
            self.put_index(number, &entries)?;
            counts.push((number, u32::try_from(entries.len()).unwrap_or(u32::MAX)));
        }
        self.chunks.push(ChunkInfo { position, span, counts });
        self.chunk.clear();
        Ok(())
    }

    fn put_index(&mut self, number: u32, entries: &[(Timestamp, usize)]) -> Result<(), RosError> {
        let mut record = Vec::with_capacity(64 + entries.len() * 12);
        let count = u32::try_from(entries.len()).unwrap_or(u32::MAX).to_le_bytes();
        let (conn, version) = (number.to_le_bytes(), 1_u32.to_le_bytes());
        put_fields(&mut record, &[("op", &[Op::Index as u8]), ("ver", &version), ("conn", &conn), ("count", &count)]);
        put_length(&mut record, entries.len() * 12);
        for (time, offset) in entries {
            record.extend_from_slice(&time_bytes(*time));
            put_length(&mut record, *offset);
        }
        self.put(&record)
    }

    /// Writes the last chunk and the index, and returns the file.
    ///
    /// # Errors
    /// [`RosError::Recording`] if it cannot be written.
    pub fn finish(mut self) -> Result<W, RosError> {
        self.end_chunk()?;
        let index_position = self.position;
        for (number, channel) in std::mem::take(&mut self.connections).iter().enumerate() {
            let mut record = Vec::new();
            put_connection(&mut record, u32::try_from(number).unwrap_or(u32::MAX), channel);
            self.put(&record)?;
        }
        for info in std::mem::take(&mut self.chunks) {
            self.put(&chunk_info(&info))?;
            self.chunks.push(info);
        }
        let header = bag_header(index_position, self.numbers.len(), self.chunks.len());
        let seek = self.out.seek(SeekFrom::Start(MAGIC.len() as u64));
        seek.map_err(|error| RosError::unwritable(&error))?;
        self.put(&header)?;
        self.out.seek(SeekFrom::End(0)).map_err(|error| RosError::unwritable(&error))?;
        self.out.flush().map_err(|error| RosError::unwritable(&error))?;
        Ok(self.out)
    }
}

fn bag_header(index: u64, connections: usize, chunks: usize) -> Vec<u8> {
    let mut record = Vec::with_capacity(HEADER_LENGTH + 8);
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes();
    put_fields(
        &mut record,
        &[
            ("op", &[Op::BagHeader as u8]),
            ("index_pos", &index.to_le_bytes()),
            ("conn_count", &count(connections)),
            ("chunk_count", &count(chunks)),
        ],
    );
    let padding = HEADER_LENGTH.saturating_sub(record.len() - 4);
    put_length(&mut record, padding);
    record.resize(record.len() + padding, b' ');
    record
}

fn chunk_info(info: &ChunkInfo) -> Vec<u8> {
    let mut record = Vec::with_capacity(160 + info.counts.len() * 8);
    let count = u32::try_from(info.counts.len()).unwrap_or(u32::MAX).to_le_bytes();
    put_fields(
        &mut record,
        &[
            ("op", &[Op::ChunkInfo as u8]),
            ("ver", &1_u32.to_le_bytes()),
            ("chunk_pos", &info.position.to_le_bytes()),
            ("start_time", &time_bytes(info.span.0)),
            ("end_time", &time_bytes(info.span.1)),
            ("count", &count),
        ],
    );
    put_length(&mut record, info.counts.len() * 8);
    for (number, messages) in &info.counts {
        record.extend_from_slice(&number.to_le_bytes());
        record.extend_from_slice(&messages.to_le_bytes());
    }
    record
}
