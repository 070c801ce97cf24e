//! Fabricated evidence: a record signed with a key the attacker has, anchored by an account that nobody suspended, in a
//! folder like that of `records export`; and the verdict of `authros evidence verify`.

use std::path::{Path, PathBuf};

use authros::chain::merkle::{Leaf, Tree};
use authros::chain::{Call, Chain, ChainOptions, Endpoint};
use authros::crypto::{SmKeyPair, domain, keyfile, signature_der, signer_id};
use authros::model::{Address, Digest, Domain, Hash, Header, Timestamp};
use serde_json::{Value, json};

use crate::Outcome;
use crate::served::Served;
use crate::support::member::Member;
use crate::support::{Authros, Home, text, wait_until};

/// The signed bytes: this label, the domain, the digest.
const LABEL: &[u8] = b"AuthROS/signature/1";

/// A chain that is served, its administrator, alice, and an account that anchors for anyone.
pub struct Scene {
    pub home: Home,
    pub boss: Authros,
    pub alice: Authros,
    pub address: String,
    pub served: Served,
    chain: Chain,
    domain: Domain,
}

impl Scene {
    pub async fn new() -> Self {
        let home = Home::new();
        let served = Served::start(&home);
        let (boss, alice) = (home.authros().with(&["--robots", "0"]), home.profile("alice"));
        boss.enrol();
        let address = alice.enrol();
        home.profile("free").enrol();
        let contract = text(&boss.json(&["chain", "status"]), "contract").parse().expect("an address");
        let endpoint = Endpoint::Node { url: served.url(), roots: None };
        let options = ChainOptions { endpoint, contract: None, pinned: None };
        let chain = Chain::connect(options).await.expect("a node");
        let pin = chain.use_contract(contract).await.expect("the contract");
        let domain = domain(pin.chain_id, &pin.genesis, &pin.contract);
        Self { home, boss, alice, address, served, chain, domain }
    }

    /// Alice's keys, stolen.
    pub fn stolen(&self) -> Member {
        Member::of(&self.home, "alice", self.domain)
    }

    /// A record in alice's name, anchored and written out as evidence.
    pub async fn forge(&self, signer: &SmKeyPair, captured_at: Timestamp) -> PathBuf {
        let member = self.stolen();
        let sealed = member.record_of(signer, "/robot1/odom", 1, b"what never was", captured_at);
        let (header, _) = Header::parse(&sealed.blob).expect("a record");
        let digest = Digest(member.provider().sm3(&[&sealed.blob]));
        let Header { owner, recorder, topic_id, seq, .. } = header;
        let leaf = Leaf::of(&header, digest).hash();
        let root = Tree::new(vec![leaf]).expect("a tree").root();
        let (transaction, block, block_hash) = self.anchor(root).await;
        let pin = self.chain.pin().expect("pinned");
        let folder = self.home.root().join(format!("evidence-{block}"));
        std::fs::create_dir(&folder).expect("a folder");
        let message = [LABEL, &self.domain.0, &digest.0].concat();
        let proof = json!({
            "format": "authros-proof/1", "digest": digest, "signer": signer_id(&signer.public),
            "signing_key": signer.public, "epoch": header.epoch, "recorder": recorder, "topic_id": topic_id,
            "seq": seq, "domain": self.domain, "chain_id": pin.chain_id, "genesis": pin.genesis,
            "contract": pin.contract, "owner": owner,
            "anchor": {
                "mode": "batch", "leaf": leaf, "index": 0, "count": 1, "path": [], "root": root,
                "transaction": transaction, "block": block, "block_hash": block_hash,
            },
        });
        let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("written");
        write("record.bin", &sealed.blob);
        write("message.bin", &message);
        write("signature.bin", &signature_der(&sealed.signature));
        write("signer.pem", keyfile::sm2_public_pem(&signer.public).expect("a key").as_bytes());
        write("proof.json", proof.to_string().as_bytes());
        folder
    }

    /// A root anchored by the account that anchors for anyone: transaction, block, its hash.
    async fn anchor(&self, root: Hash) -> (Hash, u64, Hash) {
        let eoa = Member::of(&self.home, "free", self.domain).keyring.eoa;
        let account: Address = eoa.address();
        let previous = self.chain.anchor_head(account).await.expect("a head");
        let nonce = self.chain.nonce(account, true).await.expect("a nonce");
        let call = Call::Anchor { root, count: 1, previous };
        let signed = self.chain.sign(&eoa, nonce, &call).await.expect("signs");
        self.chain.broadcast(&signed.raw).await.expect("takes it");
        for _ in 0..600 {
            if let Some(receipt) = self.chain.receipt(signed.hash).await.expect("answers") {
                assert!(receipt.success, "anchored: {:?}", receipt.reason);
                return (signed.hash, receipt.block, receipt.block_hash);
            }
            tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        }
        panic!("not mined in 30 s");
    }

    /// How a stranger without a home judges a folder: refused for `reason`, or accepted as evidence.
    pub fn judge(&self, folder: &Path, reason: &str) -> Outcome {
        let place = self.home.root().join("stranger");
        std::fs::create_dir_all(&place).expect("a folder");
        let stranger = Authros::bare(&place);
        let folder = folder.to_str().expect("UTF-8");
        let read = stranger.run(&["evidence", "verify", folder, "--chain", &self.served.url()]);
        let refusal = read.stdout.lines().find(|line| line.contains(reason)).unwrap_or_default().trim().to_owned();
        let verdict = read.stdout.lines().find(|line| line.contains("VERIFIED")).unwrap_or_default().trim().to_owned();
        match (read.code, verdict.contains("NOT VERIFIED")) {
            (Some(6), true) if !refusal.is_empty() => Outcome::Refused(refusal),
            (Some(0), false) if !verdict.is_empty() => Outcome::Succeeded(verdict),
            _ => Outcome::Otherwise(read.to_string()),
        }
    }

    /// Waits until the program considers a device's loan ended.
    pub fn until_expired(&self, device: &str) -> Value {
        wait_until(60, "the loan ends", || {
            let devices = crate::support::list(&self.alice.json(&["robot", "devices"]), "devices");
            devices.into_iter().find(|row| row["device"] == device && row["state"] == "expired")
        })
    }
}
