//! Who may do what: keys and their rights, the names that this server goes by, and the log of who changed what.
//!
//! ```text
//!   request ── asked for by one of our names? ── from a page that may ask? ── whose key? ── may it do this? ── handler
//!                     421                              403                       401            403
//! ```
//! What each call needs stands in one table, [`CALLS`], for both protocols. A call that is let in carries a `Ticket`; over
//! HTTP the scene is in its path, so all of this comes before the handler; over gRPC it is in the message, which the handler reads first.

mod audit;
mod held;
mod hosts;
mod key_file;
pub mod keys;
mod needs;

use std::path::Path;
use std::sync::Arc;

use axum::http::{HeaderMap, Method, Uri, header};
use headers::HeaderMapExt;
use headers::authorization::{Authorization, Bearer};

pub(super) use self::audit::Effect;
use self::audit::Entry;
pub(super) use self::held::Held;
pub use self::hosts::{HostName, Hosts, Origin};
use self::key_file::KeyFile;
pub use self::key_file::KeysUnusable;
use self::keys::{Key, Keys, Right};
pub use self::needs::{CALLS, Call, Need};
pub(super) use self::needs::{of_grpc, of_http};
use super::problem::{Code, Problem};

/// Who may do what on a server. The default: everybody who asks for it by a name of loopback may do everything.
#[derive(Clone, Debug, Default)]
pub struct Access(Arc<Rules>);

#[derive(Debug, Default)]
struct Rules {
    hosts: Hosts,
    /// None when everybody may do everything.
    keys: Option<Arc<KeyFile>>,
    /// Why this server is open to more than it should be, if it is.
    insecure: Option<String>,
}

impl Access {
    /// With the keys of a file, if there is one; without it everybody may do everything.
    /// # Errors
    /// The file cannot be read or taken.
    pub fn new(hosts: Hosts, keys: Option<&Path>) -> Result<Self, KeysUnusable> {
        let keys = keys.map(KeyFile::open).transpose()?.map(Arc::new);
        Ok(Self(Arc::new(Rules {
            hosts,
            keys,
            insecure: None,
        })))
    }

    /// The same of a server that was told to be open though it should not be; `/readyz` says why.
    #[must_use]
    pub fn insecure(self, why: String) -> Self {
        let Rules { hosts, keys, .. } = &*self.0;
        Self(Arc::new(Rules {
            hosts: hosts.clone(),
            keys: keys.clone(),
            insecure: Some(why),
        }))
    }

    /// Whether a key is needed.
    pub fn has_keys(&self) -> bool {
        self.0.keys.is_some()
    }

    /// Reads the file of keys again, if it has changed.
    pub fn reload(&self) {
        if let Some(keys) = &self.0.keys {
            keys.reload();
        }
    }

    /// Reads the file of keys again whenever it has changed. Has no end.
    pub async fn watch(self) {
        match &self.0.keys {
            Some(keys) => keys.clone().watch().await,
            None => std::future::pending().await,
        }
    }

    /// What those who run the server should know of it.
    pub(super) fn warnings(&self) -> Vec<String> {
        let broken = self.0.keys.as_ref().is_some_and(|keys| keys.is_broken());
        let broken = broken.then(|| {
            "the file of keys cannot be taken as it is now, the keys are those from before: the log says why".to_owned()
        });
        self.0.insecure.clone().into_iter().chain(broken).collect()
    }

    /// Whose pages of other origins may ask.
    pub(super) fn hosts(&self) -> &Hosts {
        &self.0.hosts
    }

    /// Checks who is asked for, and whose page asks.
    pub(super) fn check_hosts(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), Problem> {
        self.0.hosts.check(uri, headers)
    }

    /// Lets a call over HTTP in; `scene` is the one in its path.
    pub(super) fn admit_http(
        &self,
        method: &Method,
        route: Option<&str>,
        scene: Option<&str>,
        headers: &HeaderMap,
    ) -> Result<Ticket, Problem> {
        let ticket = self.admit(of_http(method, route), headers)?;
        // Where a scene is needed and none can be read, it is none that a key is for.
        ticket.permit(scene.unwrap_or_default())?;
        Ok(ticket)
    }

    /// Lets a call in as far as can be told before its scene is known: see [`Ticket::permit`].
    pub(super) fn admit(
        &self,
        call: &'static Call,
        headers: &HeaderMap,
    ) -> Result<Ticket, Problem> {
        let caller = match &self.0.keys {
            None => Caller::Anybody,
            Some(file) => match (identify(&file.keys(), headers), call.need) {
                (Ok(key), _) => Caller::Key(key),
                (Err(_), Need::Nothing) => Caller::Nobody,
                (Err(problem), _) => return Err(problem),
            },
        };
        if let (Caller::Key(key), Need::All(right)) = (&caller, call.need)
            && !key.may_everywhere(right)
        {
            let what = format!("key {:?} may not {} all scenes", key.name(), right.name());
            return Err(Problem::new(Code::Forbidden, what));
        }
        let key = caller.key().cloned();
        if let Some(key) = &key {
            tracing::Span::current().record("key", key.name());
        }
        let changes = matches!(call.need, Need::Scene(Right::Write | Right::Admin));
        Ok(Ticket {
            caller,
            file: self.0.keys.clone(),
            need: call.need,
            entry: changes.then(|| Arc::new(Entry::new(call.name, key))),
        })
    }
}

/// Whose key was sent.
fn identify(keys: &Keys, headers: &HeaderMap) -> Result<Arc<Key>, Problem> {
    let problem = |detail: &str| Problem::new(Code::Unauthenticated, detail);
    let sent = headers.typed_try_get::<Authorization<Bearer>>();
    let several = headers.get_all(header::AUTHORIZATION).iter().count() > 1;
    match sent {
        Ok(Some(_)) if several => Err(problem("there are several Authorization headers")),
        Ok(Some(sent)) => keys
            .find(sent.token())
            .cloned()
            .ok_or_else(|| problem("the key that was sent is not known")),
        Ok(None) => Err(problem("no key was sent: Authorization: Bearer KEY")),
        Err(_) => Err(problem("Authorization is not Bearer with a key")),
    }
}

#[derive(Clone, Debug)]
enum Caller {
    /// There are no keys.
    Anybody,
    /// There are keys, and none was sent; none was needed.
    Nobody,
    Key(Arc<Key>),
}

impl Caller {
    fn key(&self) -> Option<&Arc<Key>> {
        match self {
            Self::Key(key) => Some(key),
            Self::Anybody | Self::Nobody => None,
        }
    }

    fn may(&self, right: Right, scene: &str) -> bool {
        match self {
            Self::Anybody => true,
            Self::Nobody => false,
            Self::Key(key) => key.may(right, scene),
        }
    }
}

/// A call that was let in.
#[derive(Clone, Debug)]
pub(super) struct Ticket {
    caller: Caller,
    file: Option<Arc<KeyFile>>,
    need: Need,
    entry: Option<Arc<Entry>>,
}

impl Ticket {
    /// Whether it may do what it is for to this scene. Says the same of a scene that is not there.
    pub(super) fn permit(&self, scene: &str) -> Result<(), Problem> {
        let Need::Scene(right) = self.need else {
            return Ok(());
        };
        if let Some(entry) = &self.entry {
            entry.concerns(scene);
        }
        if self.caller.may(right, scene) {
            return Ok(());
        }
        let name = self.caller.key().map_or("", |key| key.name());
        let problem = Problem::new(
            Code::Forbidden,
            format!(
                "key {name:?} has not the right {} on scene {scene:?}",
                right.name()
            ),
        );
        self.failed(problem.code().kind().code);
        Err(problem)
    }

    /// Whether it may be told of this scene.
    pub(super) fn may_read(&self, scene: &str) -> bool {
        self.caller.may(Right::Read, scene)
    }

    /// Whether its key is still as it was when the call was let in.
    fn still_holds(&self) -> bool {
        match (&self.caller, &self.file) {
            (Caller::Key(key), Some(file)) => file.keys().contain(key),
            _ => true,
        }
    }

    /// Notes for the audit log what it did.
    pub(super) fn did(&self, effect: Effect) {
        if let Some(entry) = &self.entry {
            entry.did(effect);
        }
    }

    /// Notes that it went well, unless it has ended before.
    pub(super) fn done(&self) {
        if let Some(entry) = &self.entry {
            entry.done();
        }
    }

    /// Notes why it failed, by the code of the problem, unless it has ended before.
    pub(super) fn failed(&self, code: &str) {
        if let Some(entry) = &self.entry {
            entry.failed(code);
        }
    }
}
