//! The participants: keys that never change, so that a crash can be reproduced from its input alone.

use std::sync::LazyLock;

use authros::crypto::{self, EoaSecret, Provider, ProviderName, SmKeyPair, SmSecret};
use authros::gateway::Context;
use authros::model::{Address, Domain};

/// The network.
pub const DOMAIN: Domain = Domain([0x11; 32]);

/// The provider that the product uses by default.
pub fn provider() -> &'static dyn Provider {
    crypto::provider(ProviderName::default())
}

/// Network and provider.
pub fn context() -> Context {
    Context { provider: provider(), domain: DOMAIN }
}

/// Everyone's keys.
pub struct Cast {
    /// Signs records and allocations.
    pub owner: SmKeyPair,
    /// Opens envelopes.
    pub reader: SmKeyPair,
    /// The gateway's identity.
    pub gateway: SmKeyPair,
    /// The gateway's system key.
    pub system: SmKeyPair,
    /// The owner's account.
    pub account: EoaSecret,
}

impl Cast {
    /// The owner's address.
    pub fn address(&self) -> Address {
        self.account.address()
    }
}

/// The same every time.
pub static CAST: LazyLock<Cast> = LazyLock::new(|| {
    let pair = |byte| {
        let secret = SmSecret::from_slice(&[byte; 32]).expect("in range");
        SmKeyPair::from_secret(provider(), secret).expect("a pair")
    };
    let account = EoaSecret::from_slice(&[0x13; 32]).expect("in range");
    Cast { owner: pair(0x12), reader: pair(0x14), gateway: pair(0x21), system: pair(0x51), account }
});
