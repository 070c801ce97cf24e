//! The doctor: checks everything a home depends on, says how it is and what to do. Needs no passphrase, changes
//! nothing, starts no robots; a part that is embedded and not running is fine.

mod chain;
mod files;
mod peers;

use crate::config::Config;
use crate::model::clean;
use crate::paths::Home;
use crate::service::reply::{CheckStatus, DoctorCheck, DoctorView, HealthLevel, PartHealth, SiteView};
use crate::store::SiteLock;

/// Checks all of it. `site` is what a running site of this home says about its parts, or why it says nothing; `None` if
/// none runs.
pub async fn examine(home: &Home, config: &Config, site: Option<Result<SiteView, String>>) -> DoctorView {
    let mut sheet = Sheet::default();
    let runs = site.is_some();
    // Held so that no site starts while its files are checked.
    let lock = if runs { None } else { SiteLock::acquire(&home.site_lock()).ok().flatten() };
    tokio::task::block_in_place(|| {
        files::home(home, &mut sheet);
        files::keys(home, &mut sheet);
        files::ledger(home, &mut sheet);
        files::disk(home, &mut sheet);
        peers::vault(home, config, &mut sheet);
        peers::ros(config, &mut sheet);
        // A running site of this home is in the domain already, and says below what it sees.
        if !runs {
            peers::second(config, &mut sheet);
        }
    });
    chain::look(home, config, runs, &mut sheet).await;
    drop(lock);
    match site {
        Some(Ok(view)) => of_site(&view, &mut sheet),
        Some(Err(reason)) => {
            let advice = "stop the process that holds site.lock, then start the site again";
            sheet.fail("site", &format!("it does not answer: {reason}"), advice);
        }
        None => sheet.ok("site", "no site is running; start one with `authros serve` or the console"),
    }
    sheet.view()
}

/// The state of a home's peers if no site of it runs: master and chain are asked now.
pub async fn peers(home: &Home, config: &Config) -> Vec<PartHealth> {
    let (mut ros, mut chain) = (Sheet::default(), Sheet::default());
    tokio::task::block_in_place(|| peers::ros(config, &mut ros));
    chain::look(home, config, false, &mut chain).await;
    let embedded = config.ros_master.is_none();
    let site = "no site is running; start one with `authros serve` or the console";
    vec![
        ros.health("ros", if embedded { HealthLevel::Absent } else { HealthLevel::Ok }),
        chain.health("chain", HealthLevel::Ok),
        part("site", HealthLevel::Absent, site),
    ]
}

fn part(name: &str, level: HealthLevel, text: &str) -> PartHealth {
    PartHealth { part: name.to_owned(), level, text: clean(text, 300), since: None, retry: None }
}

fn of_site(site: &SiteView, sheet: &mut Sheet) {
    let failed: Vec<_> = site.health.iter().filter(|part| part.level == HealthLevel::Failed).collect();
    for part in &failed {
        sheet.fail(
            &format!("site {}", part.part),
            &part.text,
            "fix what it names; the site then continues automatically",
        );
    }
    for part in site.health.iter().filter(|part| part.level == HealthLevel::Waiting) {
        sheet.warn(&format!("site {}", part.part), &part.text, "check again in a moment");
    }
    if failed.is_empty() {
        let life = &site.life;
        sheet.ok(
            "site",
            &format!("running; {} records of this profile verified, {} pending", life.verified, life.pending),
        );
    }
}

/// The findings so far.
#[derive(Debug, Default)]
struct Sheet {
    checks: Vec<DoctorCheck>,
}

impl Sheet {
    fn add(&mut self, name: &str, status: CheckStatus, detail: &str, advice: &str) {
        let check =
            DoctorCheck { name: clean(name, 60), status, detail: clean(detail, 400), advice: clean(advice, 300) };
        self.checks.push(check);
    }

    fn ok(&mut self, name: &str, detail: &str) {
        self.add(name, CheckStatus::Ok, detail, "");
    }

    fn warn(&mut self, name: &str, detail: &str, advice: &str) {
        self.add(name, CheckStatus::Warn, detail, advice);
    }

    fn fail(&mut self, name: &str, detail: &str, advice: &str) {
        self.add(name, CheckStatus::Fail, detail, advice);
    }

    /// All findings as the health of one part: the first failure, or the first finding and `well`.
    fn health(&self, name: &str, well: HealthLevel) -> PartHealth {
        let failed = self.checks.iter().find(|check| check.status == CheckStatus::Fail);
        match failed {
            Some(check) => part(name, HealthLevel::Failed, &format!("{}; {}", check.detail, check.advice)),
            None => part(name, well, self.checks.first().map_or("", |check| check.detail.as_str())),
        }
    }

    fn view(self) -> DoctorView {
        DoctorView { ok: self.checks.iter().all(|check| check.status != CheckStatus::Fail), checks: self.checks }
    }
}
