//! `gas`: what a record costs on the chain, in one run on one embedded chain: by the paper's dataUpload,
//! in batches, and as in the prototype, which stores ciphertexts on the chain.

use std::time::Duration;

use serde::Serialize;
use serde_json::json;

use super::Lab;
use super::account::Account;
use super::foreign::sign_estimated;
use super::judgement::{Judgement, Target};
use super::network::{Directory, Network, Place, join, settle};
use super::plot::{Axis, Bar, COLOURS, Mark, Plot, Series};
use super::progress::Progress;
use super::prototype::Prototype;
use super::report::{Measured, Report};
use super::spread::{Spread, decimal, number};
use super::uploads::MESSAGE;
use authros_chain::merkle::{Inclusion, Leaf, Tree};
use authros_chain::{Call, Chain, Consensus};
use authros_crypto::{EoaSecret, Provider, random_bytes};
use authros_model::Hash;
use authros_output::table;
use authros_service::Failure;
use authros_service::reply::internal;

/// Leaves of a batch.
const BATCHES: [usize; 4] = [1, 16, 256, 4096];
/// Bytes that the prototype puts on the chain.
const SIZES: [usize; 4] = [1024, 2048, 4096, 8192];
/// Transactions of each kind; the first one finds its storage empty.
const RUNS: usize = 5;
/// The most gas of a batch.
const MOST_GAS: f64 = 70_000.0;
/// How much cheaper a record in a batch of 256 must be than an individual one.
const LEAST_RATIO: f64 = 150.0;

const NOTES: [&str; 4] = [
    "each: dataUpload of one digest; batch: anchor of a Merkle root over that many; prototype: a whole ciphertext \
     stored.",
    "first: the account's first transaction of that kind, with empty storage; later: those after it.",
    "Gas follows the Istanbul rules, as on the paper's network; the gas of a batch does not depend on its contents.",
    "The prototype follows the paper's description (contracts/bench); the paper itself gives no gas.",
];

/// One kind of transaction.
#[derive(Debug, Serialize)]
struct Row {
    /// `each`, `batch` or `prototype`.
    way: &'static str,
    /// Records in a transaction.
    records: usize,
    #[serde(flatten)]
    measured: Measured,
    /// Gas of the first transaction.
    first: u64,
    /// The least and the greatest gas of the later ones.
    later_from: u64,
    later_to: u64,
    /// `each`'s median divided by this one's, per record.
    cheaper_than_each: f64,
}

/// Measures; [`Judgement::Missed`] if a target is missed.
///
/// # Errors
/// If the chain cannot be made, or a transaction fails.
pub async fn run(lab: &Lab) -> Result<Judgement, Failure> {
    let provider = lab.provider;
    let consensus = Consensus::Poa { signers: 1, period: Duration::ZERO };
    let directory = Directory::new()?;
    let network = Network::open(&Place::Embedded(consensus), provider, directory.path(), None).await?;
    let mut progress = Progress::new("gas");
    let all = 1 + BATCHES.len() + SIZES.len();
    let mut results = vec![each(&network).await?];
    progress.at(results.len(), all);
    let leaves = leaves(&network.accounts[0])?;
    for count in BATCHES {
        results.push(batch(&network, provider, &leaves, count).await?);
        progress.at(results.len(), all);
    }
    for size in SIZES {
        results.push(prototype(&network, size).await?);
        progress.at(results.len(), all);
    }
    drop(progress);
    let each = results[0].measured.spread.p50;
    for row in &mut results {
        row.cheaper_than_each = each / row.measured.spread.p50;
    }
    let targets = targets(&results);
    let about =
        json!({ "rules": "istanbul", "targets": targets, "prototype_over_batch_256": over_prototype(&results) });
    let title = "Gas per record: ours and the prototype's way";
    let report = Report::new("gas", title, &NOTES, about, results);
    lab.outlet.show(&report, &tables(&report.results, &targets), &report.page(1, vec![plot(&report.results)]))?;
    Ok(Judgement::of(&targets))
}

fn row(way: &'static str, records: usize, bytes: usize, gas: &[u64]) -> Row {
    let per_record: Vec<f64> = gas.iter().map(|gas| number(*gas) / number(records)).collect();
    let later = gas.get(1..).unwrap_or_default().iter().copied();
    let measured =
        Measured { bytes: bytes as u64, runs: gas.len() as u64, unit: "gas/record", spread: Spread::of(&per_record) };
    Row {
        way,
        records,
        measured,
        first: gas.first().copied().unwrap_or(0),
        later_from: later.clone().min().unwrap_or(0),
        later_to: later.max().unwrap_or(0),
        cheaper_than_each: f64::NAN,
    }
}

async fn call(chain: &Chain, account: &Account, call: &Call) -> Result<u64, Failure> {
    let signed = chain.sign(&account.eoa, account.next_nonce(), call).await?;
    Ok(settle(chain, signed).await?.gas_used)
}

async fn each(network: &Network) -> Result<Row, Failure> {
    let account = &network.accounts[0];
    let mut gas = Vec::new();
    for _ in 0..RUNS {
        let sealed = account.seal(&random_bytes::<MESSAGE>()?)?;
        let upload =
            Call::DataUpload { digest: sealed.leaf.digest, token: account.token, timestamp: sealed.captured_at };
        gas.push(call(&network.chain, account, &upload).await?);
        if network.chain.uploaded_at(account.address, sealed.leaf.digest).await?.is_none() {
            return Err(internal("a digest is not on the chain"));
        }
    }
    Ok(row("each", 1, MESSAGE, &gas))
}

/// As many sealed records as the largest batch takes.
fn leaves(account: &Account) -> Result<Vec<Leaf>, Failure> {
    let most = BATCHES.iter().copied().max().unwrap_or(1);
    let body = random_bytes::<MESSAGE>()?;
    (0..most).map(|_| Ok(account.seal(&body)?.leaf)).collect()
}

/// Batches of one size by their own account, so that the first one finds its storage empty.
async fn batch(
    network: &Network,
    provider: &'static dyn Provider,
    leaves: &[Leaf],
    count: usize,
) -> Result<Row, Failure> {
    let chain = &network.chain;
    let account = join(chain, EoaSecret::generate()?, provider).await?;
    let (mut gas, mut previous) = (Vec::new(), Hash([0; 32]));
    for turn in 0..RUNS {
        // The same records in another order give another root.
        let mut chosen: Vec<Leaf> = leaves.iter().cycle().skip(turn).take(count).copied().collect();
        chosen.rotate_left(turn % count);
        let tree = Tree::new(Leaf::hashes(&chosen)).ok_or_else(|| internal("no leaves"))?;
        let anchor = Call::Anchor { root: tree.root(), count: count as u64, previous };
        gas.push(call(chain, &account, &anchor).await?);
        check(chain, &account, &tree, &chosen).await?;
        previous = tree.root();
    }
    Ok(row("batch", count, MESSAGE, &gas))
}

/// The contract holds the root, and every record's proof leads to it.
async fn check(chain: &Chain, account: &Account, tree: &Tree, leaves: &[Leaf]) -> Result<(), Failure> {
    let count = leaves.len() as u64;
    let anchored = chain.root_anchored(account.address, tree.root()).await?;
    let proven = leaves.iter().enumerate().all(|(index, leaf)| {
        Inclusion { index: index as u64, count, path: tree.path(index), root: tree.root() }.proves(leaf)
    });
    let held = anchored.is_some_and(|(_, found)| found == count);
    if held && proven { Ok(()) } else { Err(internal("a batch is not on the chain as it was anchored")) }
}

/// Whole ciphertexts of one size, by their own contract and account.
async fn prototype(network: &Network, size: usize) -> Result<Row, Failure> {
    let (chain, eoa) = (&network.chain, EoaSecret::generate()?);
    let nonce = chain.nonce(eoa.address(), true).await?;
    let prototype = Prototype::deploy(chain, &eoa, nonce).await?;
    prototype.register(chain, &eoa, nonce + 1).await?;
    let mut gas = Vec::new();
    for nonce in (nonce + 2..).take(RUNS) {
        let upload = prototype.upload(&network.accounts[1], &vec![0x5a; size])?;
        let signed = sign_estimated(chain, &eoa, nonce, Some(prototype.address), upload).await?;
        gas.push(settle(chain, signed).await?.gas_used);
    }
    Ok(row("prototype", 1, size, &gas))
}

/// Judged by what is least favourable to us: the most expensive batch, the cheapest individual upload.
fn targets(rows: &[Row]) -> Vec<Target> {
    let batches = || rows.iter().filter(|row| row.way == "batch");
    let dearest = batches().map(|row| row.first.max(row.later_to)).max().map_or(f64::NAN, number);
    let each = rows.iter().find(|row| row.way == "each").map_or(f64::NAN, |row| row.measured.spread.min);
    let in_batch = batches().find(|row| row.records == 256).map_or(f64::NAN, |row| row.measured.spread.max);
    vec![
        Target::at_most("gas of a batch", MOST_GAS, dearest),
        Target::at_least("each over a record in a batch of 256", LEAST_RATIO, each / in_batch),
    ]
}

/// How much more the prototype spends on its largest record than a record in a batch of 256 costs.
fn over_prototype(rows: &[Row]) -> f64 {
    let prototype = rows.iter().filter(|row| row.way == "prototype").map(|row| row.measured.spread.p50);
    let in_batch = rows.iter().find(|row| row.way == "batch" && row.records == 256);
    prototype.fold(f64::NAN, f64::max) / in_batch.map_or(f64::NAN, |row| row.measured.spread.p50)
}

fn tables(results: &[Row], targets: &[Target]) -> Vec<String> {
    let head = ["way", "records", "bytes", "first", "later", "gas per record", "times cheaper than each"];
    let cells = |row: &Row| {
        let later = if row.later_from == row.later_to {
            row.later_to.to_string()
        } else {
            format!("{}-{}", row.later_from, row.later_to)
        };
        vec![
            row.way.to_owned(),
            row.records.to_string(),
            row.measured.bytes.to_string(),
            row.first.to_string(),
            later,
            decimal(row.measured.spread.p50),
            format!("{:.3}", row.cheaper_than_each),
        ]
    };
    let rows: Vec<Vec<String>> = results.iter().map(cells).collect();
    let over = over_prototype(results);
    let over = format!("8 KB the prototype's way over a record in a batch of 256: {}", decimal(over));
    vec![table(&head, &rows), Target::lines(targets), over]
}

fn plot(rows: &[Row]) -> Plot {
    let of_way = |way: &'static str, colour| {
        let bar = |row: &Row| Bar::plain(row.measured.spread.p50).filter(|_| row.way == way);
        Series::new(way, colour, Mark::Bars(rows.iter().map(bar).collect()))
    };
    let series = vec![of_way("batch", COLOURS[0]), of_way("each", COLOURS[1]), of_way("prototype", COLOURS[4])];
    let names = rows.iter().map(|row| match row.way {
        "batch" => format!("batch of {}", row.records),
        way => format!("{way}, {} KB", row.measured.bytes / 1024),
    });
    Plot {
        title: "Gas per record; a batch is one transaction whatever is in it".to_owned(),
        across: Axis::places("", names),
        left: Axis::decades("gas per record", series.iter().flat_map(Series::values)),
        right: None,
        series,
    }
}
