//! `gateway`: records that a gateway accepts per second and core, beside what SM2 verification and SM3
//! alone would allow in the same run, and the cost of idle connections. Both ends are in this process.

mod desk;
mod idle;
mod sender;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::json;
use tokio::task::{JoinSet, block_in_place};

use self::desk::BenchDesk;
use self::sender::Sender;
use super::Lab;
use super::args::GatewayArguments;
use super::judgement::Judgement;
use super::network::Directory;
use super::plot::{Axis, Bar, COLOURS, Mark, Plot, Series};
use super::progress::Progress;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use authros_crypto::Provider;
use authros_crypto::record::signed_bytes;
use authros_gateway::{
    Answer, Cabinet, Client, Context, Credentials, Endpoint, GatewayError, Limits, Request, Schedule, Server, Trust,
    Upload,
};
use authros_model::{Digest, Timestamp};
use authros_output::table;
use authros_service::Failure;
use authros_service::reply::internal;

/// Bytes of a message, and how many records for each eight requested.
const SIZES: [(usize, usize); 2] = [(1024, 8), (58 * 1024, 1)];
/// Simultaneous uploads.
const WINDOW: usize = 32;
/// Records in one UploadMany.
const MANY: usize = 64;
/// How often everything is measured.
const RUNS: usize = 3;
/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(60);
/// A file system in memory, where fsync is free.
const MEMORY: &str = "/dev/shm";

const NOTES: [&str; 6] = [
    "each: an upload, its receipt, the next; window: 32 uploads in flight; many: 64 records in one UploadMany.",
    "disk: the store in the temporary directory, fsynced before the receipt; memory: the same in /dev/shm, \
     where fsync is free.",
    "A gateway processes a connection's frames one after another, so one connection keeps one core busy; per core = \
     records divided by the smaller of connections and cores.",
    "bound: SM3 of the blob and SM2 verification of its signature on one core in the same run; sm2 sign is what a receipt costs on top.",
    "Both ends are in this process and share its cores; the client checks a receipt's signature with `each` only.",
    "idle: resident memory of both ends for connections that have authenticated and are silent.",
];

/// One way of uploading, or one part of the bound.
#[derive(Debug, Serialize)]
struct Row {
    /// `each`, `window`, `many`; or `sm3`, `sm2 verify`, `bound`, `sm2 sign`.
    way: &'static str,
    /// `disk` or `memory`; none for the bound.
    kept: Option<&'static str>,
    connections: usize,
    records: usize,
    #[serde(flatten)]
    measured: Measured,
    /// By the median: bytes of messages, 10^6 a second.
    mb_per_second: f64,
    /// By the median: records a second and core.
    per_core: f64,
    /// `per_core` over the bound's median.
    of_bound: f64,
}

/// Measures.
///
/// # Errors
/// If the gateway cannot be made, or refuses a record.
pub async fn run(lab: &Lab, arguments: &GatewayArguments) -> Result<Judgement, Failure> {
    let provider = lab.provider;
    let sender = Sender::new(provider)?;
    // First, while the allocator holds no freed memory.
    let idle = idle::measure(&sender, arguments.idle as usize).await?;
    let places = places()?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let widths = if cores > 1 { vec![1, 4 * cores] } else { vec![1] };
    let mut progress = Progress::new("gateway");
    let mut results = Vec::new();
    let all = SIZES.len() * (4 + places.len() * widths.len() * Way::ALL.len());
    for (bytes, share) in SIZES {
        let count = (arguments.records as usize * share / 8).max(1);
        let records = block_in_place(|| sender.seal_all(count, bytes))?;
        let bounds = block_in_place(|| bounds(provider, &sender, &records, bytes))?;
        let bound = bounds[BOUND].measured.spread.p50;
        results.extend(bounds);
        let records = Arc::new(records);
        for place in &places {
            for connections in widths.iter().copied().filter(|width| *width <= count) {
                for way in Way::ALL {
                    progress.at(results.len(), all);
                    let rates = rates(&sender, place, &records, connections, way).await?;
                    let row = row(way.name(), bytes, count, &rates);
                    let lanes = number(connections.min(cores));
                    let per_core = row.measured.spread.p50 / lanes;
                    results.push(Row {
                        kept: Some(place.name),
                        connections,
                        per_core,
                        of_bound: per_core / bound,
                        ..row
                    });
                }
            }
        }
    }
    drop(progress);
    let report = Report::new("gateway", "Records accepted by a gateway", &NOTES, json!({ "idle": idle }), results);
    let plots = SIZES.iter().map(|(bytes, _)| plot(&report.results, *bytes)).collect();
    lab.outlet.show(&report, &[text(&report.results), idle.line()], &report.page(1, plots))?;
    Ok(Judgement::Reached)
}

/// Where records are kept.
struct Place {
    name: &'static str,
    directory: Directory,
}

fn places() -> Result<Vec<Place>, Failure> {
    let mut places = vec![Place { name: "disk", directory: Directory::new()? }];
    // Without such a file system its rows are left out.
    places.extend(Directory::within(Path::new(MEMORY)).ok().map(|directory| Place { name: "memory", directory }));
    Ok(places)
}

/// How records are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Way {
    Each,
    Window,
    Many,
}

impl Way {
    const ALL: [Self; 3] = [Self::Each, Self::Window, Self::Many];

    fn name(self) -> &'static str {
        match self {
            Self::Each => "each",
            Self::Window => "window",
            Self::Many => "many",
        }
    }
}

fn row(way: &'static str, bytes: usize, records: usize, rates: &[f64]) -> Row {
    let spread = Spread::of(rates);
    let measured = Measured { bytes: bytes as u64, runs: rates.len() as u64, unit: "records/s", spread };
    let mb_per_second = spread.p50 * number(bytes) / 1e6;
    let (kept, connections, of_bound) = (None, 0, f64::NAN);
    Row { way, kept, connections, records, measured, mb_per_second, per_core: spread.p50, of_bound }
}

/// The index in [`bounds`] of both together.
const BOUND: usize = 2;

/// The most one core can do: SM3, SM2 verification, both, and the cost of a receipt's signature.
fn bounds(
    provider: &'static dyn Provider,
    sender: &Sender,
    records: &[Upload],
    bytes: usize,
) -> Result<Vec<Row>, Failure> {
    let digests: Vec<Digest> = records.iter().map(|record| Digest(provider.sm3(&[&record.blob]))).collect();
    let hash = |index: usize| Ok(Digest(provider.sm3(&[&records[index].blob])));
    let verify = |index: usize, digest: Digest| {
        let signed = signed_bytes(&sender.domain, &digest);
        provider.verify(&sender.signing.public, &signed, &records[index].signature).map(|()| digest)
    };
    let sign = |index: usize| {
        provider.sign(&sender.signing.secret, &signed_bytes(&sender.domain, &digests[index])).map(|_| digests[index])
    };
    Ok(vec![
        row("sm3", bytes, records.len(), &timed(&digests, hash)?),
        row("sm2 verify", bytes, records.len(), &timed(&digests, |index| verify(index, digests[index]))?),
        row("bound", bytes, records.len(), &timed(&digests, |index| verify(index, hash(index)?))?),
        row("sm2 sign", bytes, records.len(), &timed(&digests, sign)?),
    ])
}

/// Work done for every record, per second, by this thread alone; it must return the record's digest.
fn timed(
    digests: &[Digest],
    work: impl Fn(usize) -> Result<Digest, authros_crypto::CryptoError>,
) -> Result<Vec<f64>, Failure> {
    let mut rates = Vec::new();
    for _ in 0..RUNS {
        let begun = Instant::now();
        for (index, digest) in digests.iter().enumerate() {
            if work(index)? != *digest {
                return Err(internal("a digest changed"));
            }
        }
        rates.push(number(digests.len()) / begun.elapsed().as_secs_f64());
    }
    Ok(rates)
}

/// A gateway with its own store.
struct Stage {
    desk: Arc<BenchDesk>,
    server: Server,
    endpoint: Endpoint,
    credentials: Credentials,
}

impl Stage {
    async fn open(sender: &Sender, directory: &Path, connections: usize) -> Result<Self, Failure> {
        let context = Context { provider: sender.provider, domain: sender.domain };
        let (desk, credentials) = BenchDesk::open(sender, directory)?;
        let desk = Arc::new(desk);
        let (path, identity) = (directory.join("gateway"), sender.gateway.clone());
        let schedule = Schedule::default();
        let cabinet = Cabinet::open(&path, context, identity, schedule, Timestamp::now())?;
        let most = connections + 10;
        let limits = Limits {
            connections: most,
            connections_of_peer: most,
            handshakes: most,
            handshake_burst: 1e9,
            frame_rate: 1e9,
            byte_rate: 1e12,
            ..Limits::default()
        };
        let shared = Arc::clone(&desk);
        let server = Server::start("127.0.0.1:0", shared, context, cabinet, limits).await;
        let server = server.map_err(|error| internal(format!("the gateway cannot listen: {error}")))?;
        let address = server.address().to_string();
        Ok(Self {
            desk,
            server,
            endpoint: Endpoint { addresses: vec![address], context, patience: PATIENCE, source: None },
            credentials,
        })
    }

    async fn connect(&self) -> Result<Client, Failure> {
        let mut trust = Trust::pinned(self.server.id());
        Client::connect(&self.endpoint, &mut trust, &self.credentials).await.map_err(of_gateway)
    }

    async fn close(self) {
        self.server.stop(Duration::from_secs(1)).await;
    }
}

fn of_gateway(error: GatewayError) -> Failure {
    Failure::new(error.kind(), error.to_string())
}

/// Records accepted per second, each run with a new gateway and an empty store.
async fn rates(
    sender: &Sender,
    place: &Place,
    records: &Arc<Vec<Upload>>,
    connections: usize,
    way: Way,
) -> Result<Vec<f64>, Failure> {
    let mut rates = Vec::new();
    for _ in 0..RUNS {
        let directory = Directory::within(place.directory.path())?;
        let stage = Stage::open(sender, directory.path(), connections).await?;
        let mut clients = Vec::new();
        for _ in 0..connections {
            clients.push(stage.connect().await?);
        }
        let share = records.len().div_ceil(connections);
        let (mut uploading, begun) = (JoinSet::new(), Instant::now());
        for (lane, client) in clients.into_iter().enumerate() {
            let records = Arc::clone(records);
            let part = (lane * share).min(records.len())..((lane + 1) * share).min(records.len());
            uploading.spawn(async move { upload(client, &records[part], way).await });
        }
        while let Some(done) = uploading.join_next().await {
            done.map_err(|error| internal(error.to_string()))?.map_err(of_gateway)?;
        }
        rates.push(number(records.len()) / begun.elapsed().as_secs_f64());
        let kept = stage.desk.kept()?;
        stage.close().await;
        if kept != records.len() as u64 {
            return Err(internal(format!("{kept} of {} records were stored", records.len())));
        }
    }
    Ok(rates)
}

async fn upload(mut client: Client, records: &[Upload], way: Way) -> Result<(), GatewayError> {
    match way {
        Way::Each => {
            for record in records {
                client.upload(vec![record.clone()]).await?;
            }
        }
        Way::Window => {
            for window in records.chunks(WINDOW) {
                let mut sent = Vec::with_capacity(WINDOW);
                for record in window {
                    sent.push(client.send(&Request::Upload(record.clone())).await?);
                }
                for number in sent {
                    receipt(&mut client, number, 1).await?;
                }
            }
        }
        Way::Many => {
            for many in records.chunks(MANY) {
                let number = client.send(&Request::UploadMany(many.to_vec())).await?;
                receipt(&mut client, number, many.len()).await?;
            }
        }
    }
    Ok(())
}

async fn receipt(client: &mut Client, number: u32, count: usize) -> Result<(), GatewayError> {
    match client.receive(PATIENCE).await? {
        (answered, Answer::Receipt(_, receipt)) if answered == number && receipt.digests.len() == count => Ok(()),
        (_, Answer::Refused(code)) => Err(GatewayError::Refused(code)),
        _ => Err(GatewayError::Unexpected("no receipt")),
    }
}

fn text(rows: &[Row]) -> String {
    let head = ["way", "kept", "connections", "bytes", "records", "records/s", "MB/s", "per core", "of the bound"];
    let cells = |row: &Row| {
        let ratio = if row.of_bound.is_finite() { format!("{:.2}", row.of_bound) } else { "-".to_owned() };
        vec![
            row.way.to_owned(),
            row.kept.unwrap_or("-").to_owned(),
            row.connections.to_string(),
            row.measured.bytes.to_string(),
            row.records.to_string(),
            decimal(row.measured.spread.p50),
            decimal(row.mb_per_second),
            decimal(row.per_core),
            ratio,
        ]
    };
    table(&head, rows.iter().map(cells))
}

/// Records a second for each way of uploading, beside the most one core could do.
fn plot(results: &[Row], bytes: usize) -> Plot {
    let rows: Vec<&Row> = results.iter().filter(|row| row.measured.bytes == bytes as u64).collect();
    let of_kept = |name: &str, colour, kept: Option<&str>| {
        let bars = rows.iter().map(|row| {
            let spread = row.measured.spread;
            Bar::between(spread.p50, spread.min, spread.max).filter(|_| row.kept == kept)
        });
        Series::new(name, colour, Mark::Bars(bars.collect()))
    };
    let series = vec![
        of_kept("at most, on one core", COLOURS[3], None),
        of_kept("kept on disk", COLOURS[0], Some("disk")),
        of_kept("kept in memory", COLOURS[1], Some("memory")),
    ];
    let names = rows.iter().map(|row| match row.kept {
        Some(_) => format!("{} by {}", row.way, row.connections),
        None => row.way.to_owned(),
    });
    Plot {
        title: format!("records of {bytes} bytes; whiskers: the slowest and the fastest run"),
        across: Axis::places("way of uploading, number of connections", names),
        left: Axis::decades("records a second", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
