//! Reads of the contract and of accounts, at the newest block.

use ethers::abi::Token as AbiToken;
use ethers::types::{U64, U256};
use serde_json::{Value, json};

use super::artefact::artefact;
use super::call::{address, word};
use super::error::decode_revert_hex;
use super::event::end;
use super::{AccountState, Call, Chain, ChainError, ChainStatus, GrantState, QueryAnswer};
use crate::model::{Address, Digest, Hash, Identity, Token, bytes::hex, bytes::unhex};

/// No account has sent so many transactions.
const NO_NONCE: u64 = 1 << 32;
/// The most transactions of one account that a node may hold: far above any node's pool.
const MOST_PENDING: u64 = 100_000;

/// The next nonces of an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nonces {
    /// After everything that is mined.
    pub mined: u64,
    /// After everything that the node holds.
    pub pending: u64,
}

impl Chain {
    /// The chain's properties and, for `account`, its holdings.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn status(&self, account: Option<Address>) -> Result<ChainStatus, ChainError> {
        let mut status = ChainStatus {
            kind: self.kind().to_owned(),
            consensus: self.inner.consensus.to_owned(),
            chain_id: self.chain_id(),
            genesis: self.genesis(),
            block: self.head().await?.number,
            contract: self.pin().map(|pin| pin.contract),
            balance: None,
            nonce: None,
            pending: None,
            client: self.inner.client.clone(),
        };
        if let Some(account) = account {
            let nonce = self.nonce(account, false).await?;
            status.balance = Some(self.balance(account).await?.to_string());
            status.nonce = Some(nonce);
            status.pending = Some(self.nonce(account, true).await?.saturating_sub(nonce));
        }
        Ok(status)
    }

    fn kind(&self) -> &'static str {
        match self.transport() {
            relayed if relayed.is_relayed() => "relay",
            transport if transport.embedded().is_some() => "embedded",
            _ => "node",
        }
    }

    /// Wei held by an account.
    pub(super) async fn balance(&self, account: Address) -> Result<U256, ChainError> {
        self.rpc("eth_getBalance", json!([account.to_string(), "latest"])).await
    }

    /// The next nonce of an account; `pending` counts transactions not yet mined. If a node keeps no pending state, the
    /// mined nonce is returned.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn nonce(&self, account: Address, pending: bool) -> Result<u64, ChainError> {
        let ask = |tag: &'static str| self.rpc::<U64>("eth_getTransactionCount", json!([account.to_string(), tag]));
        let nonce = match ask(if pending { "pending" } else { "latest" }).await {
            Err(ChainError::Rejected { .. }) if pending => ask("latest").await?,
            answered => answered?,
        };
        let nonce = nonce.as_u64();
        if nonce < NO_NONCE {
            Ok(nonce)
        } else {
            Err(self.misunderstood("eth_getTransactionCount", &nonce.to_string()))
        }
    }

    /// Both next nonces of an account. They check each other: a node that answers one of them wrongly is not believed,
    /// because a transaction signed for a nonce far ahead would never be mined.
    ///
    /// # Errors
    /// [`ChainError::Answer`] if they contradict each other, or an error of the node.
    pub async fn nonces(&self, account: Address) -> Result<Nonces, ChainError> {
        let (mined, pending) = (self.nonce(account, false).await?, self.nonce(account, true).await?);
        if (mined..=mined.saturating_add(MOST_PENDING)).contains(&pending) {
            return Ok(Nonces { mined, pending });
        }
        let reason = format!("{mined} as the mined nonce and {pending} as the pending one contradict each other");
        Err(self.misunderstood("eth_getTransactionCount", &reason))
    }

    /// Simulates a call without sending it.
    ///
    /// # Errors
    /// [`ChainError::Reverted`] with the reason if the contract would refuse, otherwise an error of the node.
    pub async fn simulate(&self, from: Address, call: &Call) -> Result<(), ChainError> {
        self.eth_call(from, self.contract()?, &call.encode()?, "latest").await.map(|_| ())
    }

    pub(super) async fn eth_call(
        &self,
        from: Address,
        to: Address,
        data: &[u8],
        block: &str,
    ) -> Result<Vec<u8>, ChainError> {
        let message = json!({ "from": from.to_string(), "to": to.to_string(), "data": format!("0x{}", hex(data)) });
        let output: String = self.rpc("eth_call", json!([message, block])).await?;
        // Old geth returns a revert as if it were a result.
        match decode_revert_hex(&output) {
            Some(code) if output.len() % 64 == 10 => Err(ChainError::Reverted { code }),
            _ => unhex(&output).ok_or_else(|| self.misunderstood("eth_call", "it is not hex")),
        }
    }

    async fn view(&self, from: Address, name: &str, arguments: &[AbiToken]) -> Result<Answer<'_>, ChainError> {
        let artefact = artefact()?;
        let data = artefact.encode(name, arguments)?;
        let output = self.eth_call(from, self.contract()?, &data, "latest").await?;
        let values = artefact.function(name)?.decode_output(&output);
        let values = values.map_err(|error| self.misunderstood(name, &error.to_string()))?;
        Ok(Answer { chain: self, name: name.to_owned(), values: values.into_iter() })
    }

    /// The state of a registered account; `None` if it is not registered.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn account(&self, owner: Address) -> Result<Option<AccountState>, ChainError> {
        let mut answer = self.view(owner, "accountOf", &[address(owner)]).await?;
        let identity = answer.take(AbiToken::into_bytes)?;
        let epoch = answer.number()?;
        if epoch == 0 {
            return Ok(None);
        }
        let identity = Identity::parse(&identity).map_err(|error| answer.wrong(&error.to_string()))?;
        let token = Token(answer.word()?);
        let suspended = answer.flag()?;
        let (keys, count) = (answer.number()?, answer.number()?);
        let last = Digest(answer.word()?);
        let last = (count > 0).then_some(last);
        Ok(Some(AccountState { identity, epoch, token, suspended, keys, count, last }))
    }

    /// The paper's dataQuery, as `from` would be answered. A node does not authenticate `from`.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn data_query(&self, from: Address, token: Token, owner: Address) -> Result<QueryAnswer, ChainError> {
        let arguments = [AbiToken::Bytes(token.0.to_vec()), address(owner)];
        let mut answer = self.view(from, "dataQuery", &arguments).await?;
        let authorised = answer.flag()?;
        Ok(QueryAnswer { authorised, epoch: answer.number()?, count: answer.number()?, last: Digest(answer.word()?) })
    }

    /// Whether an owner uploaded this digest individually (not in a batch).
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn anchored(&self, owner: Address, digest: Digest) -> Result<bool, ChainError> {
        Ok(self.uploaded_at(owner, digest).await?.is_some())
    }

    /// The block in which an owner uploaded this digest individually.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn uploaded_at(&self, owner: Address, digest: Digest) -> Result<Option<u64>, ChainError> {
        let mut answer = self.view(owner, "uploadedAt", &[address(owner), word(digest.0)]).await?;
        let block = answer.number()?;
        Ok((block != 0).then_some(block))
    }

    /// The block in which an account first anchored a root, and the number of its leaves.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn root_anchored(&self, account: Address, root: Hash) -> Result<Option<(u64, u64)>, ChainError> {
        let mut answer = self.view(account, "anchorOf", &[address(account), word(root.0)]).await?;
        let (block, count) = (answer.number()?, answer.number()?);
        Ok((block != 0).then_some((block, count)))
    }

    /// The root that an account anchored last; zero before the first.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn anchor_head(&self, account: Address) -> Result<Hash, ChainError> {
        self.view(account, "headOf", &[address(account)]).await?.word().map(Hash)
    }

    /// An owner's grant to an account; `None` if there never was one.
    ///
    /// # Errors
    /// Errors of the node.
    pub async fn grant(&self, owner: Address, grantee: Address) -> Result<Option<GrantState>, ChainError> {
        let mut answer = self.view(owner, "grantOf", &[address(owner), address(grantee)]).await?;
        let state = GrantState { active: answer.flag()?, epoch: answer.number()?, expiry: end(answer.number()?) };
        Ok((state.epoch != 0).then_some(state))
    }

    /// Ends a chain that runs in this process and waits until its file is closed; other chains are unaffected.
    pub async fn end(&self) {
        if let Some(chain) = self.transport().embedded() {
            chain.end().await;
        }
    }

    /// Writes the embedded chain, as it is between two blocks, to a new file; `false` for other chains.
    ///
    /// # Errors
    /// [`ChainError::File`] if it cannot be written.
    pub async fn copy_to(&self, path: std::path::PathBuf) -> Result<bool, ChainError> {
        match self.transport().embedded() {
            Some(embedded) => embedded.copy_to(path).await.map(|()| true),
            None => Ok(false),
        }
    }

    /// Runs every block of the embedded chain again and compares; returns how many, `None` for other chains.
    ///
    /// # Errors
    /// [`ChainError::Tampered`] for the first block, or the first node of the state, that was altered.
    pub async fn run_again(&self) -> Result<Option<u64>, ChainError> {
        match self.transport().embedded() {
            Some(embedded) => embedded.audit().await.map(Some),
            None => Ok(None),
        }
    }

    /// All call data, storage slots and logs of the embedded chain, for the test that it holds no secret.
    ///
    /// # Errors
    /// [`ChainError::Input`] for other chains.
    pub async fn dump(&self) -> Result<Vec<Vec<u8>>, ChainError> {
        match self.transport().embedded() {
            Some(embedded) => embedded.dump().await,
            None => Err(ChainError::Input("only the embedded chain can be dumped; use it for this".into())),
        }
    }
}

/// The values that a view returned, in order.
struct Answer<'a> {
    chain: &'a Chain,
    name: String,
    values: std::vec::IntoIter<AbiToken>,
}

impl Answer<'_> {
    fn wrong(&self, reason: &str) -> ChainError {
        self.chain.misunderstood(&self.name, reason)
    }

    fn take<T>(&mut self, convert: impl FnOnce(AbiToken) -> Option<T>) -> Result<T, ChainError> {
        self.values.next().and_then(convert).ok_or_else(|| self.wrong("a value has the wrong type"))
    }

    fn flag(&mut self) -> Result<bool, ChainError> {
        self.take(AbiToken::into_bool)
    }

    fn number(&mut self) -> Result<u64, ChainError> {
        self.take(|value| value.into_uint()?.try_into().ok())
    }

    fn word(&mut self) -> Result<[u8; 32], ChainError> {
        self.take(|value| value.into_fixed_bytes()?.try_into().ok())
    }
}

/// The reason why a mined transaction failed: from the receipt if the node includes it (ours and Besu), otherwise by
/// running it again on the block before.
pub(super) async fn reason(chain: &Chain, receipt: &Value, block: u64) -> Option<String> {
    if let Some(code) = receipt.get("revertReason").and_then(Value::as_str).and_then(decode_revert_hex) {
        return Some(code);
    }
    let hash = receipt.get("transactionHash")?;
    let sent: Value = chain.rpc("eth_getTransactionByHash", json!([hash])).await.ok()?;
    let field = |name: &str| sent.get(name)?.as_str().map(str::to_lowercase);
    let from = field("from")?.parse().ok()?;
    let to = field("to")?.parse().ok()?;
    let before = format!("{:#x}", block.saturating_sub(1));
    match chain.eth_call(from, to, &unhex(&field("input")?)?, &before).await {
        Err(ChainError::Reverted { code }) => Some(code),
        _ => None,
    }
}
