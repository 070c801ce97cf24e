//! `authros bench pictures`: raw matrices and small messages compressed, sealed, opened, restored, with each codec and
//! without. The data are synthetic: smooth surfaces with sensor noise.

mod drawn;
mod plots;

use std::time::Instant;

use png::{ColorType, Compression as Effort, Filter};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::account::head;
use super::judgement::Judgement;
use super::machine::Machine;
use super::outlet::Outlet;
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, bars, decimal, number};
use authros_crypto::compression::{pack, unpack};
use authros_crypto::{Anchor, Expected, Provider, SealRequest, SmKeyPair, TopicKey, open, random_bytes, seal};
use authros_model::head::Compression;
use authros_model::{Address, Domain, RecordKind, RecorderId, Timestamp, TopicId};
use authros_output::table;
use authros_service::Failure;
use authros_service::failure::internal;
use drawn::Message;

/// Rounds of each combination.
const RUNS: usize = 5;

const NOTES: [&str; 3] = [
    "none: sealed as it is; lz4: one LZ4 block; matrix: what the sealer chooses for matrices (filters and fast Deflate).",
    "png: the same idea by the png crate, fast and at its default effort; byte matrices only; the result is discarded.",
    "total = compress + seal (SM4-GCM, SM3, SM2 signature); open = the same checked and decrypted; restore = unpacked.",
];

/// One message with one codec.
#[derive(Debug, Serialize)]
struct Row {
    message: &'static str,
    codec: &'static str,
    #[serde(flatten)]
    measured: Measured,
    /// Bytes sealed.
    sealed: usize,
    /// Medians, milliseconds.
    compress: f64,
    seal: f64,
    open: f64,
    restore: f64,
    paper: Option<f64>,
}

/// One codec.
struct Codec {
    name: &'static str,
    pack: fn(&Message) -> Option<Vec<u8>>,
    unpack: fn(&Message, &[u8]) -> Option<Vec<u8>>,
}

const CODECS: [Codec; 5] = [
    Codec { name: "none", pack: |message| Some(message.body.clone()), unpack: |_, bytes| Some(bytes.to_vec()) },
    Codec {
        name: "lz4",
        pack: |message| Some(lz4_flex::block::compress(&message.body)),
        unpack: |message, bytes| lz4_flex::block::decompress(bytes, message.body.len()).ok(),
    },
    Codec {
        name: "matrix",
        pack: |message| {
            let packed = pack(&message.body, message.matrix.as_ref())?;
            (packed.compression == Compression::Matrix).then_some(packed.bytes)
        },
        unpack: |message, bytes| unpack(Compression::Matrix, bytes, message.body.len()).ok(),
    },
    Codec { name: "png, fast", pack: |message| png(message, Effort::Fast), unpack: unpng },
    Codec { name: "png", pack: |message| png(message, Effort::Balanced), unpack: unpng },
];

fn png(message: &Message, effort: Effort) -> Option<Vec<u8>> {
    let (matrix, pixels) = (message.matrix?, message.pixels()?);
    let colour = match (matrix.channels, matrix.sample) {
        (3, 1) => ColorType::Rgb,
        (1, 1) => ColorType::Grayscale,
        _ => return None,
    };
    let mut out = Vec::new();
    let size = (u32::try_from(matrix.columns).ok()?, u32::try_from(matrix.rows).ok()?);
    let mut encoder = png::Encoder::new(&mut out, size.0, size.1);
    encoder.set_color(colour);
    encoder.set_compression(effort);
    encoder.set_filter(Filter::Adaptive);
    let mut writer = encoder.write_header().ok()?;
    writer.write_image_data(pixels).ok()?;
    writer.finish().ok()?;
    Some(out)
}

fn unpng(message: &Message, bytes: &[u8]) -> Option<Vec<u8>> {
    let matrix = message.matrix?;
    let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().ok()?;
    let mut pixels = vec![0; reader.output_buffer_size()?];
    reader.next_frame(&mut pixels).ok()?;
    let (before, behind) = (message.body.get(..matrix.start)?, message.body.get(matrix.start + pixels.len()..)?);
    Some([before, &pixels, behind].concat())
}

/// What seals.
struct Bench {
    provider: &'static dyn Provider,
    signer: SmKeyPair,
    key: TopicKey,
}

/// Milliseconds of each step.
struct Times {
    compress: f64,
    seal: f64,
    open: f64,
    restore: f64,
    sealed: usize,
}

/// Measures every message with every codec.
///
/// # Errors
/// If a message is not restored as it was, or the random source fails.
pub fn run(provider: &'static dyn Provider, outlet: &Outlet) -> Result<Judgement, Failure> {
    let bench = Bench { provider, signer: SmKeyPair::generate(provider)?, key: TopicKey::new(random_bytes()?) };
    let (mut results, messages) = (Vec::new(), drawn::all());
    let (mut progress, all) = (Progress::new("pictures"), messages.len() * CODECS.len());
    for (turn, message) in messages.iter().enumerate() {
        for (at, codec) in CODECS.iter().enumerate() {
            results.extend(bench.measure(message, codec)?);
            progress.at(turn * CODECS.len() + at + 1, all);
        }
    }
    drop(progress);
    let about = Map::from_iter([("notes".to_owned(), json!(NOTES))]);
    let report = Report { name: "pictures", machine: Machine::read(), about, results };
    outlet.show(&report, || text(&report), || plots::page(&report))?;
    Ok(Judgement::Reached)
}

impl Bench {
    fn measure(&self, message: &Message, codec: &Codec) -> Result<Option<Row>, Failure> {
        let mut rounds = Vec::with_capacity(RUNS);
        for _ in 0..RUNS {
            let begun = Instant::now();
            let Some(packed) = (codec.pack)(message) else { return Ok(None) };
            let compress = milliseconds(begun);
            rounds.push(self.round(message, codec, &packed, compress)?);
        }
        let median = |of: fn(&Times) -> f64| Spread::of(&rounds.iter().map(of).collect::<Vec<_>>()).p50;
        let total: Vec<f64> = rounds.iter().map(|times| times.compress + times.seal).collect();
        Ok(Some(Row {
            message: message.name,
            codec: codec.name,
            measured: Measured {
                bytes: message.body.len() as u64,
                runs: RUNS as u64,
                unit: "ms",
                spread: Spread::of(&total),
            },
            sealed: rounds.first().map_or(0, |times| times.sealed),
            compress: median(|times| times.compress),
            seal: median(|times| times.seal),
            open: median(|times| times.open),
            restore: median(|times| times.restore),
            paper: None,
        }))
    }

    fn round(&self, message: &Message, codec: &Codec, packed: &[u8], compress: f64) -> Result<Times, Failure> {
        let request = SealRequest {
            domain: Domain([1; 32]),
            owner: Address([2; 20]),
            signer: &self.signer,
            epoch: 1,
            topic_key: &self.key,
            recorder: RecorderId([3; 16]),
            seq: 1,
            topic_id: TopicId([4; 16]),
            kind: RecordKind::Data,
            filters: Vec::new(),
            captured_at: Timestamp(1),
            // Every codec's bytes are sealed the same way, as a message of their own length.
            head: &head(packed.len()),
            body: packed,
        };
        let begun = Instant::now();
        let record = seal(self.provider, &request)?;
        let seal = milliseconds(begun);
        let expected = Expected::any_of(request.domain, request.owner);
        let anchor = Anchor::Chain(record.digest);
        let begun = Instant::now();
        let public = &self.signer.public;
        let opened = open(self.provider, &record.blob, &record.signature, public, anchor, &self.key, &expected)?;
        let open = milliseconds(begun);
        let begun = Instant::now();
        let restored = (codec.unpack)(message, &opened.body);
        let restore = milliseconds(begun);
        if restored.as_ref() != Some(&message.body) {
            return Err(internal(format!("{} was not restored by {}", message.name, codec.name)));
        }
        Ok(Times { compress, seal, open, restore, sealed: packed.len() })
    }
}

fn milliseconds(begun: Instant) -> f64 {
    begun.elapsed().as_secs_f64() * 1e3
}

fn text(report: &Report<Row>) -> String {
    let row = |row: &Row| {
        let share = number(u32::try_from(row.sealed).unwrap_or(u32::MAX))
            / number(u32::try_from(row.measured.bytes).unwrap_or(u32::MAX)).max(1.0);
        let times = [row.compress, row.seal, row.measured.spread.p50, row.open, row.restore];
        let mut cells = vec![row.message.to_owned(), row.codec.to_owned(), row.measured.bytes.to_string()];
        cells.extend([row.sealed.to_string(), format!("{} %", decimal(share * 100.0))]);
        cells.extend(times.map(|time| format!("{time:.2}")));
        cells
    };
    let head = ["message", "codec", "bytes", "sealed", "share", "compress ms", "seal", "total", "open", "restore"];
    let rows: Vec<Vec<String>> = report.results.iter().map(row).collect();
    let notes = report.about.get("notes").and_then(Value::as_array).cloned().unwrap_or_default();
    let notes: Vec<&str> = notes.iter().filter_map(Value::as_str).collect();
    let name = |row: &Row| format!("{}, {}", row.message, row.codec);
    let total = report.results.iter().map(|row| (name(row), row.measured.spread.p50)).collect::<Vec<_>>();
    let bars = bars(&total, "ms").join("\n");
    format!("{}\n{}\n\ntotal\n{bars}\n\n{}", report.machine.line(), table(&head, &rows), notes.join("\n"))
}
