//! What a mission must keep off the chain, collected for the test that searches for it there.

use super::mission::Mission;
use crate::crypto::topic_key;
use crate::model::Hash;
use crate::pipeline::reader::Reader;
use crate::service::Failure;
use crate::store::RecordQuery;

type Named = Vec<(String, Vec<u8>)>;

impl Mission {
    /// All call data, storage and logs of the embedded chain.
    ///
    /// # Errors
    /// On other chains.
    pub async fn chain_dump(&self) -> Result<Vec<Vec<u8>>, Failure> {
        Ok(self.network.chain.dump().await?)
    }

    /// Every key, topic name, type, profile name and some plaintext of the mission.
    ///
    /// # Errors
    /// If a record cannot be opened.
    pub async fn secrets(&self) -> Result<Named, Failure> {
        let mut named = Named::new();
        let names = [
            "cura-a",
            "cura-b",
            "stranger",
            "nav_msgs/Odometry",
            "sensor_msgs/CompressedImage",
            "crime-scene",
            "simulated",
        ];
        named.extend(names.iter().map(|name| ((*name).to_owned(), name.as_bytes().to_vec())));
        named.extend(self.topics.iter().map(|topic| (topic.to_string(), topic.as_str().as_bytes().to_vec())));
        for person in [&self.cura_a, &self.cura_b, &self.stranger] {
            self.keys_of(&person.owner, &mut named);
        }
        let reader = Reader { plant: &self.site.plant, network: &self.network, reader: &self.cura_a.owner };
        for row in self.some_rows()? {
            let opened = reader.open(&row).await?;
            let middle = opened.body.len() / 2;
            named.push((
                format!("plaintext of {}", row.id),
                opened.body.get(middle..middle + 24).unwrap_or(&opened.body).to_vec(),
            ));
        }
        Ok(named)
    }

    fn keys_of(&self, owner: &crate::pipeline::Owner, named: &mut Named) {
        let keyring = owner.keyring();
        let keys = keyring.keys();
        let mut add = |what: &str, bytes: &[u8]| named.push((format!("{what} of {}", owner.profile), bytes.to_vec()));
        add("EOA key", keys.eoa.expose());
        add("signing key", keys.signing.secret.expose());
        add("envelope key", keys.envelope.secret.expose());
        add("SM4 key", keys.sm4.expose());
        add("index key", keys.index.expose());
        for network in keys.networks.values() {
            for secret in network.epochs.values() {
                add("epoch key", secret.key.expose());
                for topic in &self.topics {
                    // Not by the owner: the keyring is in use here.
                    let id = crate::crypto::topic_id(&keys.index, topic.as_str());
                    add("topic key", topic_key(&secret.key, &id).expose());
                }
            }
        }
    }

    fn some_rows(&self) -> Result<Vec<crate::store::RecordRow>, Failure> {
        let query = RecordQuery { owner: Some(self.cura_a.address), limit: 20, ..RecordQuery::default() };
        Ok(self.site.plant.ledger.records.list(&query)?.rows)
    }

    /// What the chain holds for some of the mission's records: their batches' roots, or their digests.
    ///
    /// # Errors
    /// Errors of the ledger.
    pub fn some_anchors(&self) -> Result<Vec<Hash>, Failure> {
        let anchor = |row: crate::store::RecordRow| {
            let placed = self.site.plant.ledger.records.placed(row.digest)?;
            let place = placed.and_then(|placed| placed.place);
            Ok(place.map_or(Hash(row.digest.0), |place| place.inclusion.root))
        };
        self.some_rows()?.into_iter().map(anchor).collect()
    }

    /// Ends the mission's site.
    pub async fn end(self) {
        let site = std::sync::Arc::clone(&self.site);
        drop(self);
        site.stop().await;
    }
}
