//! `authros config`.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::Subcommand;

use super::connect::Context;
use super::printed;
use crate::config::SettingView;
use crate::model::ErrorKind;
use crate::service::{Failure, accounts};
use authros_output::{Output, table};

/// `config …`
#[derive(Debug, Subcommand)]
pub enum ConfigVerb {
    /// Show every setting, its value and its source
    Show,
    /// Check the settings
    Check,
}

pub fn run(context: &Context, verb: &ConfigVerb, output: &Output) -> Result<u8, Failure> {
    let settings = context.config.show();
    match verb {
        ConfigVerb::Show => output.result(&serde_json::json!({ "settings": settings }), || list(&settings)),
        ConfigVerb::Check => {
            printed::themes(&context.home, context.config.console.theme.as_deref())?;
            let unknown = accounts::unknown(&context.config.operators.rules)?;
            if !unknown.is_empty() {
                return Err(Failure::new(ErrorKind::Input, unknown.join("; ")));
            }
            output.result(&serde_json::json!({ "ok": true }), || "the settings are valid".to_owned());
        }
    }
    Ok(0)
}

fn list(settings: &[SettingView]) -> String {
    let row = |setting: &SettingView| {
        [setting.name.to_owned(), setting.value.clone(), setting.source.clone(), setting.text.to_owned()]
    };
    table(&["setting", "value", "from", "meaning"], settings.iter().map(row))
}
