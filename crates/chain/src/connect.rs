//! Connecting: which chain this is, whether it is the pinned one, and which contract is in use.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::time::{Duration, Instant};

use ethers::types::{H160, H256, U64, U256};
use ethers::utils::keccak256;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Value, json};

use crate::model::{Address, Domain, Hash, Wei, clean};
use crate::transaction::{RawReceipt, Unsigned, created_address};
use crate::{
    BlockRef, Chain, ChainError, ChainOptions, Endpoint, Pin, Policy, Priced, STARVING, Shortfall, Wait,
    call::artefact, crypto::EoaSecret, embedded, fees, model::bytes::unhex, transport::Transport,
};

pub(super) const POLL: Duration = Duration::from_millis(200);

#[derive(Debug)]
pub(super) struct Inner {
    pub transport: Transport,
    pub chain_id: u64,
    pub genesis: Hash,
    pub client: String,
    pub consensus: &'static str,
    pub contract: RwLock<Option<Pin>>,
    /// Estimates of frequent calls.
    pub gas: Mutex<HashMap<(Address, &'static str), u64>>,
    /// Gas limit of the newest block seen.
    pub block_room: Mutex<Option<u64>>,
    /// Whether headers have blooms, once known.
    pub makes_blooms: OnceLock<bool>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct RawBlock {
    pub number: U64,
    pub hash: H256,
    pub parent_hash: Option<H256>,
    pub timestamp: U64,
    pub difficulty: Option<Value>,
    pub extra_data: Option<String>,
    mix_hash: Option<String>,
    pub base_fee_per_gas: Option<U256>,
    gas_limit: Option<U256>,
    pub gas_used: Option<U256>,
    pub logs_bloom: Option<Value>,
    #[serde(default)]
    pub transactions: Vec<Value>,
}

impl Inner {
    fn new(transport: Transport, chain_id: u64, genesis: Hash) -> Self {
        Self {
            transport,
            chain_id,
            genesis,
            client: "unknown".to_owned(),
            consensus: "unknown",
            contract: RwLock::default(),
            gas: Mutex::default(),
            block_room: Mutex::default(),
            makes_blooms: OnceLock::new(),
        }
    }
}

impl Chain {
    /// Opens the embedded chain, or connects to a node, and compares it with the pin.
    pub async fn connect(options: ChainOptions) -> Result<Self, ChainError> {
        if let (Endpoint::Embedded { directory, .. }, Some(_)) = (&options.endpoint, &options.pinned)
            && !embedded::file_in(directory).exists()
        {
            return Err(ChainError::Gone { path: embedded::file_in(directory) });
        }
        let transport = Transport::open(&options.endpoint).await?;
        let chain_id: U64 = rpc(&transport, "eth_chainId", json!([])).await?;
        let genesis: RawBlock = rpc(&transport, "eth_getBlockByNumber", json!(["0x0", false])).await?;
        let latest: RawBlock = rpc(&transport, "eth_getBlockByNumber", json!(["latest", false])).await?;
        let client: Option<String> = rpc(&transport, "web3_clientVersion", json!([])).await.ok();
        let client = clean(&client.unwrap_or_else(|| "unknown".into()), 80);
        let consensus = match options.endpoint {
            Endpoint::Embedded { .. } => transport.embedded().map_or("poa", |chain| chain.line.consensus.word()),
            Endpoint::Node { .. } | Endpoint::Relay(_) => consensus(&latest, &client),
        };
        let inner = Inner::new(transport, chain_id.as_u64(), Hash(genesis.hash.0));
        let inner = Inner { client, consensus, ..inner };
        let chain = Self { inner: Arc::new(inner) };
        match (options.contract, options.pinned) {
            (contract, Some(pin)) => chain.hold_against(contract, pin).await?,
            (Some(contract), None) => {
                chain.use_contract(contract).await?;
            }
            (None, None) => {}
        }
        Ok(chain)
    }

    /// A chain known only by its pin; every request fails with `why`.
    pub fn absent(pin: Pin, why: String) -> Self {
        let transport = Transport::absent(ChainError::Absent { why });
        let inner = Inner::new(transport, pin.chain_id, pin.genesis);
        Self { inner: Arc::new(Inner { contract: RwLock::new(Some(pin)), ..inner }) }
    }

    /// Asks again for chain id, genesis block and code, and compares them with the pin.
    pub async fn identify(&self) -> Result<(), ChainError> {
        let pin = self.pin().ok_or(ChainError::NoContract)?;
        let chain_id: U64 = self.rpc("eth_chainId", json!([])).await?;
        let genesis: RawBlock = self.rpc("eth_getBlockByNumber", json!(["0x0", false])).await?;
        self.same("chain id", pin.chain_id.to_string(), chain_id.to_string())?;
        self.same("genesis block", pin.genesis.to_hex(), Hash(genesis.hash.0).to_hex())?;
        self.same_code(&pin).await
    }

    fn same(&self, what: &'static str, pinned: String, found: String) -> Result<(), ChainError> {
        if pinned == found { Ok(()) } else { Err(ChainError::Swapped { url: self.url(), what, pinned, found }) }
    }

    async fn same_code(&self, pin: &Pin) -> Result<(), ChainError> {
        let code = self.code_hash(pin.contract).await?;
        let found = code.map_or_else(|| "no code".to_owned(), |hash| hash.to_hex());
        self.same("contract code hash", pin.code_hash.to_hex(), found)
    }

    async fn hold_against(&self, contract: Option<Address>, pin: Pin) -> Result<(), ChainError> {
        self.same("chain id", pin.chain_id.to_string(), self.chain_id().to_string())?;
        self.same("genesis block", pin.genesis.to_hex(), self.genesis().to_hex())?;
        if let Some(contract) = contract {
            self.same("contract", pin.contract.to_string(), contract.to_string())?;
        }
        self.same_code(&pin).await?;
        if pin.code_hash != artefact()?.code_hash {
            return Err(ChainError::NotTheContract(pin.contract));
        }
        self.set_pin(pin);
        Ok(())
    }

    /// Pretends that the chain was swapped; for the tests of other crates.
    #[doc(hidden)]
    pub fn pretending(&self, pin: Pin) -> Self {
        self.set_pin(pin);
        self.clone()
    }

    /// Uses an existing contract if its code is this program's.
    pub async fn use_contract(&self, contract: Address) -> Result<Pin, ChainError> {
        let code_hash = artefact()?.code_hash;
        if self.code_hash(contract).await? != Some(code_hash) {
            return Err(ChainError::NotTheContract(contract));
        }
        let deployed_at = self.deployment_block(contract).await?;
        Ok(self.set_pin(self.pin_of(contract, code_hash, deployed_at)))
    }

    pub async fn has_contract(&self, contract: Address) -> Result<bool, ChainError> {
        Ok(self.code_hash(contract).await? == Some(artefact()?.code_hash))
    }

    pub fn created_by(&self, account: Address, nonce: u64) -> Address {
        created_address(account, nonce)
    }

    pub fn domain_of(&self, contract: Address) -> Domain {
        crate::crypto::domain(self.chain_id(), &self.genesis(), &contract)
    }

    pub(super) fn pin_of(&self, contract: Address, code_hash: Hash, deployed_at: u64) -> Pin {
        Pin { chain_id: self.chain_id(), genesis: self.genesis(), contract, code_hash, deployed_at }
    }

    pub(super) fn set_pin(&self, pin: Pin) -> Pin {
        *self.inner.contract.write().unwrap_or_else(PoisonError::into_inner) = Some(pin.clone());
        self.forget_gas();
        pin
    }

    /// Block of the constructor's event; 0 if the node does not say, which only slows reading.
    async fn deployment_block(&self, contract: Address) -> Result<u64, ChainError> {
        let signature = artefact()?.event_signature("AdministratorChanged")?;
        match self.first_with(contract, signature).await {
            Ok(block) => Ok(block.unwrap_or(0)),
            Err(ChainError::Rejected { .. }) => Ok(0),
            Err(error) => Err(error),
        }
    }

    /// Keccak-256; `None` without code.
    pub(super) async fn code_hash(&self, contract: Address) -> Result<Option<Hash>, ChainError> {
        let code: String = self.rpc("eth_getCode", json!([contract.to_string(), "latest"])).await?;
        let bytes = unhex(&code).ok_or_else(|| self.misunderstood("eth_getCode", "it is not hex"))?;
        Ok((!bytes.is_empty()).then(|| Hash(keccak256(bytes))))
    }

    /// `None` before a contract is used.
    pub fn pin(&self) -> Option<Pin> {
        self.inner.contract.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn contract(&self) -> Result<Address, ChainError> {
        self.pin().map(|pin| pin.contract).ok_or(ChainError::NoContract)
    }

    pub fn chain_id(&self) -> u64 {
        self.inner.chain_id
    }

    pub fn genesis(&self) -> Hash {
        self.inner.genesis
    }

    /// Without credentials.
    pub fn url(&self) -> String {
        self.transport().url().to_owned()
    }

    pub(super) fn transport(&self) -> &Transport {
        &self.inner.transport
    }

    pub(super) async fn rpc<R: DeserializeOwned>(&self, method: &str, parameters: Value) -> Result<R, ChainError> {
        rpc(self.transport(), method, parameters).await
    }

    pub(super) fn misunderstood(&self, method: &str, reason: &str) -> ChainError {
        ChainError::Answer { url: self.url(), method: method.to_owned(), reason: clean(reason, 200) }
    }

    pub async fn head(&self) -> Result<BlockRef, ChainError> {
        Ok(self.newest().await?.reference())
    }

    /// `None` above the head.
    pub async fn block(&self, number: u64) -> Result<Option<BlockRef>, ChainError> {
        Ok(self.raw_block(number).await?.as_ref().map(RawBlock::reference))
    }

    pub(super) async fn raw_block(&self, number: u64) -> Result<Option<RawBlock>, ChainError> {
        self.rpc("eth_getBlockByNumber", json!([format!("{number:#x}"), false])).await
    }

    pub(super) async fn newest(&self) -> Result<RawBlock, ChainError> {
        self.rpc("eth_getBlockByNumber", json!(["latest", false])).await
    }

    /// On a development node, gives an empty account 10 ether; returns whether it did.
    pub async fn fund_from_node(&self, account: Address) -> Result<bool, ChainError> {
        if !self.is_development() || !self.balance(account).await?.is_zero() {
            return Ok(false);
        }
        self.fund_by_transfer(account).await
    }

    fn is_development(&self) -> bool {
        let client = self.inner.client.to_lowercase();
        let named = ["anvil", "ganache", "hardhat", "ethereumjs"].iter().any(|name| client.contains(name));
        named || (client.contains("geth") && self.chain_id() == GETH_DEV)
    }

    async fn fund_by_transfer(&self, account: Address) -> Result<bool, ChainError> {
        let unlocked: Vec<H160> = answered(self.rpc("eth_accounts", json!([])).await)?.unwrap_or_default();
        let value = format!("{GIFT:#x}");
        for giver in unlocked {
            let gift = json!({ "from": giver, "to": account.to_string(), "value": value });
            let head = self.head().await?.number;
            if answered(self.rpc::<Value>("eth_sendTransaction", json!([gift])).await)?.is_some() {
                return self.wait_for_gift(account, head).await;
            }
        }
        Ok(false)
    }

    async fn wait_for_gift(&self, account: Address, mut head: u64) -> Result<bool, ChainError> {
        let deadline = tokio::time::Instant::now() + ARRIVAL;
        while self.balance(account).await?.is_zero() {
            if tokio::time::Instant::now() >= deadline {
                return Ok(false);
            }
            head = self.next_block(head, Duration::from_secs(1)).await?.number;
        }
        Ok(true)
    }

    /// Deploys with open registration and [`DEFAULT_DELAY`], and waits until it is mined.
    pub async fn deploy(&self, eoa: &EoaSecret) -> Result<Pin, ChainError> {
        Ok(self.deploy_with(eoa, DEFAULT_DELAY, Policy::default()).await?.pin)
    }

    pub async fn deploy_with(&self, eoa: &EoaSecret, delay: Duration, terms: Policy) -> Result<Deployment, ChainError> {
        let artefact = artefact()?;
        let input = artefact.creation(true, delay.as_secs())?;
        let nonce = self.nonce(eoa.address(), true).await?;
        let creation = Unsigned { nonce, input, ..Unsigned::default() };
        let (receipt, raised) = self.create(eoa, creation, terms).await?;
        let Some(contract) = receipt.contract_address.filter(|_| receipt.status.is_none_or(|s| !s.is_zero())) else {
            let reason = "the deployment failed; the network must run the Istanbul fork or newer";
            return Err(ChainError::Rejected { method: "eth_sendRawTransaction".into(), reason: reason.into() });
        };
        let contract = Address(contract.0);
        if self.code_hash(contract).await? != Some(artefact.code_hash) {
            return Err(ChainError::NotTheContract(contract));
        }
        let pin = self.set_pin(self.pin_of(contract, artefact.code_hash, receipt.block_number.as_u64()));
        Ok(Deployment { pin, raised })
    }

    /// Raises the price whenever blocks pass it by, until it is mined.
    async fn create(
        &self,
        eoa: &EoaSecret,
        creation: Unsigned,
        policy: Policy,
    ) -> Result<(RawReceipt, Option<u128>), ChainError> {
        let market = self.market().await?;
        let mut price = match policy.fresh(&market) {
            Priced::At(price) => price,
            Priced::Capped { needed, cap } => return Err(ChainError::TooDear { needed: Wei(needed), cap: Wei(cap) }),
        };
        let gas = match self.estimate(eoa.address(), None, &creation.input).await {
            Err(ChainError::InsufficientFunds) => {
                // What a creation costs (Yellow Paper, appendix G), its constructor aside.
                let gas = 53_000 + 216 * creation.input.len() as u64;
                return Err(self.poor(eoa, price, gas).await);
            }
            estimate => fees::with_margin(estimate?).min(self.room().unwrap_or(u64::MAX)),
        };
        let (mut sent, mut wait): (Vec<Hash>, _) = (Vec::new(), Wait::from(market.head.number, STARVING));
        loop {
            let terms = Unsigned { gas_price: price, gas_limit: gas, ..creation.clone() };
            let signed = terms.sign(eoa, self.chain_id())?;
            match self.broadcast(&signed.raw).await {
                Ok(_) | Err(ChainError::AlreadyKnown) => {}
                Err(ChainError::InsufficientFunds) => return Err(self.poor(eoa, price, gas).await),
                // An earlier one may be in a block by now.
                Err(ChainError::NonceTooLow | ChainError::Underpriced) if !sent.is_empty() => {}
                Err(error) => return Err(error),
            }
            sent.push(signed.hash);
            let deadline = Instant::now() + PATIENCE;
            price = loop {
                if let Some(receipt) = self.one_of(&sent).await? {
                    return Ok((receipt, wait.is_raised().then_some(price)));
                }
                let market = self.market().await?;
                let head = market.head.number;
                if wait.is_due(head)
                    && policy.raises(&market)
                    && let Priced::At(higher) = policy.replacement(price, &market)
                {
                    wait.raise(head);
                    break higher;
                }
                if Instant::now() > deadline {
                    let blocks = wait.passed_by(head).unwrap_or(0);
                    return Err(ChainError::NotMined { seconds: wait.length().as_secs(), blocks, price: Wei(price) });
                }
                self.next_block(head, Duration::from_secs(1)).await?;
            };
        }
    }

    async fn one_of(&self, sent: &[Hash]) -> Result<Option<RawReceipt>, ChainError> {
        for hash in sent.iter().rev() {
            if let Some((receipt, _)) = self.raw_receipt(*hash).await? {
                return Ok(Some(receipt));
            }
        }
        Ok(None)
    }

    async fn poor(&self, eoa: &EoaSecret, price: u128, gas: u64) -> ChainError {
        let needed = Wei(price.saturating_mul(u128::from(gas)));
        match self.wealth(eoa.address()).await {
            Ok(held) => ChainError::NoEther(Shortfall { account: eoa.address(), held: Wei(held), needed }),
            Err(error) => error,
        }
    }
}

impl RawBlock {
    /// `None` if the node does not say, or says nonsense.
    pub(super) fn room(&self) -> Option<u64> {
        self.gas_limit.and_then(|limit| u64::try_from(limit).ok()).filter(|limit| *limit > 0)
    }

    pub(super) fn reference(&self) -> BlockRef {
        let timestamp = self.timestamp.as_u64();
        BlockRef { number: self.number.as_u64(), hash: Hash(self.hash.0), timestamp }
    }
}

async fn rpc<R: DeserializeOwned>(transport: &Transport, method: &str, parameters: Value) -> Result<R, ChainError> {
    transport.request(method, parameters).await.map_err(|error| error.explained(transport.url(), method))
}

fn consensus(latest: &RawBlock, client: &str) -> &'static str {
    /// Written into the mix hash by QBFT and IBFT.
    const BYZANTINE: &str = "0x63746963616c2062797a616e74696e65206661756c7420746f6c6572616e6365";
    let difficulty = latest.difficulty.as_ref().and_then(Value::as_str).unwrap_or("0x0");
    let extra = latest.extra_data.as_ref().map_or(0, String::len);
    let client = client.to_lowercase();
    if ["anvil", "ganache", "hardhat"].iter().any(|name| client.contains(name)) {
        "dev"
    } else if latest.mix_hash.as_deref() == Some(BYZANTINE) || extra >= 2 + 2 * 97 {
        "poa"
    } else if difficulty == "0x0" {
        "pos"
    } else {
        "pow"
    }
}

// Ether for test accounts, only from development nodes.

/// 10 ether, in wei.
const GIFT: u64 = 10_000_000_000_000_000_000;
const ARRIVAL: Duration = Duration::from_secs(15);
/// The chain id of `geth --dev`, which its client version does not reveal.
const GETH_DEV: u64 = 1337;

/// A refusal means no; a broken connection stays an error.
fn answered<T>(result: Result<T, ChainError>) -> Result<Option<T>, ChainError> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error @ (ChainError::Unreachable { .. } | ChainError::Answer { .. })) => Err(error),
        Err(_) => Ok(None),
    }
}

// Deploying the contract.

/// Patience with a deployment at one price.
const PATIENCE: Duration = Duration::from_secs(60);
const DAY: Duration = Duration::from_secs(86_400);
pub const DEFAULT_DELAY: Duration = Duration::from_secs(7 * DAY.as_secs());
/// Contract limit.
pub const SHORTEST_DELAY: Duration = DAY;
/// Contract limit.
pub const LONGEST_DELAY: Duration = Duration::from_secs(365 * DAY.as_secs());
/// Contract limit.
pub const LONGEST_PAUSE: Duration = Duration::from_secs(3 * DAY.as_secs());

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deployment {
    pub pin: Pin,
    /// Wei per gas, if blocks passed it by at lower prices.
    pub raised: Option<u128>,
}
