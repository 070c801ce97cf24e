//! Resolves settings, joins the running site or opens one, and prepares the profile.

use std::io::ErrorKind as IoKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::{args::Global, passphrase};
use crate::config::{Config, Source};
use crate::model::{ErrorKind, OperatorName, ProfileName};
use crate::paths::{Home, PlaceError};
use crate::service::command::{CreateIdentity, ShowIdentity, Unlock};
use crate::service::reply::{input, refused};
use crate::service::socket::{self, Greeting};
use crate::service::{Client, Failure, Needs, Site, accounts::Account, looking};
use crate::store::{SiteLock, files};
use authros_output::Output;

/// Interval between attempts to become the site.
const AGAIN: Duration = Duration::from_millis(100);
/// Patience with a silent process that holds the home.
const SILENCE: Duration = Duration::from_secs(5);
/// Patience with a command that is the site: below systemd's start timeout.
const LONGEST_COMMAND: Duration = Duration::from_secs(60);
/// Time for joined processes to get their answers after a signal.
const FAREWELL: Duration = Duration::from_millis(500);

pub struct Context {
    pub global: Global,
    pub home: Home,
    pub profile: ProfileName,
    pub config: Config,
    /// Set where somebody else's site is joined; `None` = the owner.
    pub operator: Option<Operator>,
}

pub struct Operator {
    pub socket: PathBuf,
    /// The user's name, as the site will see it.
    pub name: OperatorName,
}

pub struct Connection {
    pub client: Client,
    /// Set if this process is the site.
    pub site: Option<Arc<Site>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProfileNeed {
    None,
    Unlocked,
    /// Keyring open if a passphrase is given; otherwise the site begins once it is opened, and the command says so.
    OpenAtSite,
    /// Keyring open, created first if missing.
    Made,
}

pub(super) fn environment(name: &str) -> Option<String> {
    std::env::var(name).ok()
}

fn misplaced(error: PlaceError) -> Failure {
    Failure::new(error.kind(), error.to_string())
}

/// Names the home where HOME is not set, so that nobody has to search for it.
fn say_without_home(home: &Home, output: &Output) {
    if std::env::var_os("HOME").is_none_or(|value| value.is_empty()) {
        let root = home.root().display();
        output.note(&format!("HOME is not set: using {root} for this site and its settings; set HOME or pass --home"));
    }
}

impl Context {
    pub fn new(global: Global, output: &Output) -> Result<Self, Failure> {
        let profile = super::parse::value(global.profile.as_deref().unwrap_or("default"))?;
        let standard = || Home::standard().map_err(misplaced);
        let home = global.home.clone().map_or_else(standard, |root| Ok(Home::new(root)))?;
        if global.home.is_none() {
            say_without_home(&home, output);
        }
        let config = Self::read_config(&global, &home)?;
        if let Some(kernel) = config.sm4_kernel {
            kernel.force().map_err(|error| input(error.to_string()))?;
        }
        let operator = match global.site_socket.clone() {
            Some(socket) => Some(Operator { socket, name: Account::own()?.name }),
            None => None,
        };
        Ok(Self { global, home, profile, config, operator })
    }

    /// Without `--home`, an agent has its own home below the standard one.
    pub fn for_agent(global: Global, name: &ProfileName, output: &Output) -> Result<Self, Failure> {
        if global.home.is_some() {
            return Self::new(global, output);
        }
        let own = Home::standard_root().map_err(misplaced)?.join("agents").join(name.as_str());
        say_without_home(&Home::new(own.clone()), output);
        Self::new(Global { home: Some(own), ..global }, output)
    }

    fn read_config(global: &Global, home: &Home) -> Result<Config, Failure> {
        let path = home.config();
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => Some(text),
            Err(error) if matches!(error.kind(), IoKind::NotFound | IoKind::NotADirectory) => None,
            Err(error) => return Err(input(format!("{} cannot be read: {error}", path.display()))),
        };
        let file = text.as_deref().map(|text| (path.as_path(), text));
        Ok(Config::resolve(&|name| global.setting(name), &environment, file)?)
    }

    /// The settings of a home that would begin with these, and of this machine.
    pub fn beginning_with(&self, settings: &str) -> Result<Config, Failure> {
        let file = Some((Path::new("the join file"), settings));
        Ok(Config::resolve(&|name| self.global.setting(name), &environment, file)?)
    }

    /// Connects, prepares the profile, does `work`, closes the connection.
    pub async fn with<T>(
        &self,
        needs: Needs,
        profile: ProfileNeed,
        output: &Output,
        work: impl AsyncFnOnce(&Client) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let connection = self.connect(needs).await?;
        let result = async {
            self.prepare(&connection.client, profile, output).await?;
            work(&connection.client).await
        };
        let result = result.await;
        connection.close().await;
        result
    }

    pub async fn connect(&self, needs: Needs) -> Result<Connection, Failure> {
        if let Some(operator) = &self.operator {
            return self.connect_to(&operator.socket).await;
        }
        // A short command's site has only the parts that it needs, and ends with it.
        let waits = |greeting: &Greeting, waited: Duration| match greeting.has {
            _ if greeting.stays => None,
            has if needs.chain && !has.chain => Some(LONGEST_COMMAND),
            has => (needs.ros && !has.ros && waited < FAREWELL * 4).then_some(SILENCE),
        };
        self.join_or_start(needs, "this command", waits).await
    }

    /// `waits` gives the whole patience with a site that must end first, or `None` to join it; `again` names the
    /// command to repeat.
    async fn join_or_start(
        &self,
        needs: Needs,
        again: &str,
        mut waits: impl FnMut(&Greeting, Duration) -> Option<Duration>,
    ) -> Result<Connection, Failure> {
        let (begun, mut patience) = (Instant::now(), SILENCE);
        while begun.elapsed() < patience {
            match socket::join(&self.home, self.profile.clone()).await? {
                Some((client, greeting)) => {
                    let Some(longest) = waits(&greeting, begun.elapsed()) else {
                        self.agree(&greeting)?;
                        return Ok(Connection { client, site: None });
                    };
                    patience = patience.max(longest);
                }
                None => {
                    if let Some(opened) = self.start(needs)? {
                        return Ok(opened);
                    }
                }
            }
            tokio::time::sleep(AGAIN).await;
        }
        let root = self.home.root().display();
        let text = if patience == SILENCE {
            format!("{root} is in use by another process that does not answer; stop it, or use another --home")
        } else {
            let seconds = patience.as_secs();
            format!(
                "another command is still using {root} after {seconds} s; wait for it or stop it, then run {again} again"
            )
        };
        Err(Failure::new(ErrorKind::Home, text))
    }

    /// The settings are those of the site's owner.
    async fn connect_to(&self, path: &Path) -> Result<Connection, Failure> {
        if let Some(name) = socket::BINDING.into_iter().find(|name| self.config.source(name) == Source::Flag) {
            let text = format!("{name} is set by the owner of the site at {}; omit the option", path.display());
            return Err(Failure::new(ErrorKind::Usage, text));
        }
        let client = socket::join_as_operator(path, self.profile.clone()).await?;
        Ok(Connection { client, site: None })
    }

    /// Opens a site that stays, after waiting for a command that is the site.
    pub async fn open(&self, needs: Needs, output: &Output) -> Result<Connection, Failure> {
        if self.operator.is_some() {
            let text = "--site-socket joins a site that runs already; omit it, and AUTHROS_SITE_SOCKET, to start one of \
                        your own";
            return Err(Failure::new(ErrorKind::Usage, text));
        }
        match self.stay(needs, output, "`authros serve`").await? {
            Connection { site: None, .. } => {
                let root = self.home.root().display();
                let text = format!("a site of {root} is already running; commands join it automatically");
                Err(Failure::new(ErrorKind::Home, text))
            }
            opened => Ok(opened),
        }
    }

    /// Joins a site that stays, or opens one. Waits for a command that is the site, because a joined command would end
    /// with it.
    pub async fn stay(&self, needs: Needs, output: &Output, again: &str) -> Result<Connection, Failure> {
        let (root, most, mut told) = (self.home.root().display(), LONGEST_COMMAND.as_secs(), false);
        let waits = |greeting: &Greeting, _: Duration| {
            if !greeting.stays && !std::mem::replace(&mut told, true) {
                output.note(&format!("authros: another command is using {root}; waiting up to {most} s for it to end"));
            }
            (!greeting.stays).then_some(LONGEST_COMMAND)
        };
        self.join_or_start(needs, again, waits).await
    }

    /// `None` if another process holds the home.
    fn start(&self, needs: Needs) -> Result<Option<Connection>, Failure> {
        if looking::is_read_only(&self.home) {
            return self.look(needs);
        }
        let Some(lock) = self.lock()? else { return Ok(None) };
        let site = Site::start(self.home.clone(), self.config.clone(), lock, needs)?;
        socket::listen(&site)?;
        Ok(Some(Connection { client: site.client(self.profile.clone()), site: Some(site) }))
    }

    /// Opens a read-only home through a working copy; such a site sends nothing.
    fn look(&self, needs: Needs) -> Result<Option<Connection>, Failure> {
        let Some(copy) = looking::working_copy(&self.home)? else { return Ok(None) };
        let started = || {
            let Some(lock) = SiteLock::acquire(&copy.site_lock())? else { return Ok(None) };
            let site = Site::start(copy.clone(), self.config.clone(), lock, Needs { ros: false, ..needs })?;
            Ok(Some(Connection { client: site.client(self.profile.clone()), site: Some(site) }))
        };
        started().inspect_err(|_: &Failure| looking::forget(&copy))
    }

    pub fn lock(&self) -> Result<Option<SiteLock>, Failure> {
        files::private_directory(self.home.root())?;
        Ok(SiteLock::acquire(&self.home.site_lock())?)
    }

    fn agree(&self, greeting: &Greeting) -> Result<(), Failure> {
        let mine = self.config.show();
        for (name, theirs) in &greeting.settings {
            let Some(setting) = mine.iter().find(|setting| setting.name == name) else { continue };
            // Without a site's address these concern a gateway other than the joined one.
            if name.starts_with("site.") && self.config.source("site.address") != Source::Flag {
                continue;
            }
            if self.config.source(setting.name) == Source::Flag && setting.value != *theirs {
                let advice = "omit the option, or stop that site first";
                let text = format!("the running site of this home has {name} = '{theirs}'; {advice}");
                return Err(Failure::new(ErrorKind::Usage, text));
            }
        }
        Ok(())
    }

    pub async fn prepare(&self, client: &Client, need: ProfileNeed, output: &Output) -> Result<(), Failure> {
        // Only the owner makes or opens the keyring.
        if need == ProfileNeed::None || self.operator.is_some() {
            return Ok(());
        }
        let identity = client.ask(ShowIdentity).await?;
        if !identity.exists && need == ProfileNeed::Made {
            let (passphrase, is_new) = passphrase::given_or_new(self, output)?;
            let made = client.ask(CreateIdentity { passphrase }).await;
            let made = made.inspect_err(|_| passphrase::forget_unused(is_new, self))?;
            if let Some(address) = made.address {
                output.note(&format!("identity '{}' created: {address}", self.profile));
            }
            return Ok(());
        }
        if identity.exists && !identity.unlocked {
            let given = passphrase::given(&self.global, &self.home, &self.profile)?;
            if given.is_none() && need == ProfileNeed::OpenAtSite {
                output.note(&format!(
                    "to begin, unlock it in a console, or pass {}: the keyring of profile '{}' is locked, and until it is \
                     open nothing is captured",
                    passphrase::SOURCES,
                    self.profile
                ));
                return Ok(());
            }
            let typed = || passphrase::typed(&self.home, &self.profile);
            let Some(passphrase) = given.map_or_else(typed, |given| Ok(Some(given)))? else {
                let (profile, advice) = (&self.profile, passphrase::SOURCES);
                return Err(refused(format!("the keyring of profile '{profile}' is locked; pass {advice}")));
            };
            client.ask(Unlock { passphrase }).await?;
        }
        Ok(())
    }
}

impl Connection {
    pub fn tell_read_only(&self, output: &Output) {
        let home = self.site.as_ref().map(|site| site.place());
        if let Some((home, original)) = home.as_ref().and_then(|home| Some((home, home.original()?))) {
            output.note(&format!("authros: {}", looking::about(home, original)));
        }
    }

    pub fn oversee(&self) {
        if let Some(site) = &self.site {
            site.oversee();
        }
    }

    /// Waits until joined processes have their answers.
    pub async fn close(self) {
        if let Some(site) = self.site {
            tokio::select! {
                () = unasked(&site) => {}
                _ = super::serve::asked_to_end() => {}
            }
            stop(site).await;
        }
    }

    /// After a signal: joined processes get half a second, and can ask the next site.
    pub async fn end(self) {
        if let Some(site) = self.site {
            // Whether all were answered makes no difference.
            drop(tokio::time::timeout(FAREWELL, unasked(&site)).await);
            stop(site).await;
        }
    }
}

async fn stop(site: Arc<Site>) {
    let home = site.place();
    site.stop().await;
    looking::forget(&home);
}

async fn unasked(site: &Site) {
    while site.guests() > 0 {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
