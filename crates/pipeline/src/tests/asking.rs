//! The contract is asked who may read, and its answer is compared with its events.

use super::*;
use crate::chain::QueryAnswer;
use crate::crypto::EoaSecret;
use crate::model::{Address, ErrorKind, Scope};
use crate::pipeline::PipelineError;
use crate::pipeline::authority::ask_contract;

const STRANGER: Address = Address([9; 20]);

impl Line {
    async fn send(&self, call: Call) {
        self.sender.send(&self.network.chain, &self.owner.eoa(), call, "asking").await.expect("mined");
    }

    /// A registered account that is not the owner's.
    async fn reader(&self) -> Address {
        let reader = EoaSecret::generate().expect("a key");
        let (signing, envelope) = (self.owner.signing(), self.owner.envelope().public);
        let identity =
            prove(self.plant.provider, &self.network.domain, &reader.address(), &signing, &envelope, Token([2; 32]));
        let call = Call::Register { identity: identity.expect("proven"), envelope: Vec::new() };
        self.sender.send(&self.network.chain, &reader, call, "register").await.expect("mined");
        reader.address()
    }

    fn grant(grantee: Address, epoch: u64) -> Call {
        Call::AuthorityGrant { grantee, epoch, expiry: None, scope: Scope::All, envelope: vec![1] }
    }

    async fn asked(&self, reader: Address, epoch: u64) -> Result<Option<QueryAnswer>, PipelineError> {
        ask_contract(&self.plant, &self.network, reader, self.owner.address, epoch).await
    }

    /// What the contract answers where its events say the same.
    async fn answer(&self, reader: Address, epoch: u64) -> (bool, u64, u64) {
        let answer = self.asked(reader, epoch).await.expect("agrees").expect("a token");
        (answer.authorised, answer.epoch, answer.count)
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_contract_answers_as_its_events_say() {
    let line = Line::new().await;
    let reader = line.reader().await;
    line.append(1, 1, 2);
    line.drain(AnchorMode::Each, 2, || false).await;
    let own = line.asked(line.owner.address, 1).await.expect("agrees").expect("a token");
    assert_eq!((own.authorised, own.epoch, own.count), (true, 1, 2));
    assert!(line.rows(2).iter().any(|row| row.digest == own.last), "the last one that was uploaded");
    assert_eq!(line.asked(line.owner.address, 2).await.expect("read"), None, "no token of that epoch yet");
    assert_eq!(line.answer(STRANGER, 1).await, (false, 1, 0));

    line.send(Call::Rotate { new_token: Token([3; 32]), envelope: Vec::new() }).await;
    line.send(Line::grant(reader, 2)).await;
    line.watch().await;
    assert_eq!(line.answer(reader, 2).await, (true, 2, 2));
    assert_eq!(line.answer(reader, 1).await, (false, 1, 0), "before the grant");
    line.send(Call::Wrap { epoch: 1, envelopes: vec![(reader, vec![1])] }).await;
    line.watch().await;
    assert_eq!(line.answer(reader, 1).await, (true, 1, 2), "by an envelope of its own");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_answer_that_the_events_contradict_is_refused_in_words() {
    let line = Line::new().await;
    let reader = line.reader().await;
    line.watch().await;
    let refused = async |words: &str| {
        let error = line.asked(reader, 1).await.expect_err("contradicted");
        assert_eq!(error.kind(), ErrorKind::Refused);
        let told = error.to_string();
        let claim =
            format!("the contract {words} {reader} read epoch 1 of {}, and its events up to", line.owner.address);
        assert!(told.starts_with(&claim) && told.contains("repeat the command") && told.contains("--chain"), "{told}");
    };
    // Mined, and not read here yet.
    line.send(Line::grant(reader, 1)).await;
    refused("lets").await;
    line.watch().await;
    assert_eq!(line.answer(reader, 1).await, (true, 1, 0));
    line.send(Call::AuthorityRevoke { grantee: reader, new_token: Token([3; 32]), envelope: Vec::new() }).await;
    refused("does not let").await;
    line.watch().await;
    assert_eq!(line.answer(reader, 1).await, (false, 1, 0));
}
