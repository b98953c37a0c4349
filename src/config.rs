//! How the server is set up: defaults, then a TOML file, then `UNION3D_*` variables, then flags; the later wins.
//!
//! A key has one name in all four: `queue_changes_max` in the file, `UNION3D_QUEUE_CHANGES_MAX`, `--queue-changes-max`.

use std::collections::BTreeSet;
use std::fmt::{self, Write};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use config::{Config, ConfigError, Environment, File, FileFormat, Map};
use serde::{Deserialize, Serialize};

use crate::service::{CHANGE_OPERATIONS_MAX, ServiceConfig, memory_limit_bytes};
use crate::wire::access::{HostName, Origin};
use crate::wire::door::{self, CertificateFiles};

/// How log lines look.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// An address to listen on: `127.0.0.1:7373`, `[::1]:7373`, a name (`localhost:7373`), or all addresses (`:7373`).
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ListenAddress {
    /// Without the brackets of an IPv6 address; empty for all addresses.
    host: String,
    port: u16,
}

impl ListenAddress {
    /// The sockets it may be, the first that can be had to be taken. Asks the system's resolver where it is a name.
    /// # Errors
    /// Nobody knows the name.
    pub async fn resolve(&self) -> std::io::Result<Vec<SocketAddr>> {
        if self.host.is_empty() {
            // The first takes IPv4, too, where the system has IPv6.
            let all = [
                (Ipv6Addr::UNSPECIFIED, self.port).into(),
                (Ipv4Addr::UNSPECIFIED, self.port).into(),
            ];
            return Ok(all.to_vec());
        }
        let found = tokio::net::lookup_host((self.host.as_str(), self.port)).await?;
        Ok(found.collect())
    }
}

impl FromStr for ListenAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "{text:?} is no address to listen on, such as 127.0.0.1:7373, localhost:7373 or :7373"
            )
        };
        let (host, port) = text.rsplit_once(':').ok_or_else(wrong)?;
        let digits = port.bytes().all(|byte| byte.is_ascii_digit());
        let port = port.parse().ok().filter(|_| digits).ok_or_else(wrong)?;
        let bare = host
            .strip_prefix('[')
            .and_then(|host| host.strip_suffix(']'));
        let is_name = |byte: u8| byte.is_ascii_alphanumeric() || b"-._".contains(&byte);
        let fits = match bare {
            Some(host) => host.parse::<Ipv6Addr>().is_ok(),
            None => host.bytes().all(is_name),
        };
        if !fits {
            return Err(wrong());
        }
        let host = bare.unwrap_or(host).to_owned();
        Ok(Self { host, port })
    }
}

impl TryFrom<String> for ListenAddress {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<ListenAddress> for String {
    fn from(address: ListenAddress) -> Self {
        address.to_string()
    }
}

impl From<SocketAddr> for ListenAddress {
    fn from(address: SocketAddr) -> Self {
        Self {
            host: address.ip().to_string(),
            port: address.port(),
        }
    }
}

impl fmt::Display for ListenAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.host.contains(':') {
            write!(formatter, "[{}]:{}", self.host, self.port)
        } else {
            write!(formatter, "{}:{}", self.host, self.port)
        }
    }
}

/// The settings of `union3d serve`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServeConfig {
    /// Address that HTTP listens on; port 0 picks a free one.
    pub http: ListenAddress,
    /// Address that gRPC listens on; port 0 picks a free one.
    pub grpc: ListenAddress,
    /// The server's TLS certificate and those that lead to its authority, as PEM; with it all connections are encrypted.
    pub tls_certificate: Option<PathBuf>,
    /// Its private key, as PEM.
    pub tls_key: Option<PathBuf>,
    /// The authorities, as PEM, of which every client must have a certificate.
    pub tls_client_ca: Option<PathBuf>,
    /// Seconds between two looks at these files; when they have changed, the next connection has what is new.
    pub tls_renewal_seconds: NonZeroU64,
    /// Connections at a time, of HTTP and gRPC together; further ones are closed at once.
    pub connections_max: NonZeroUsize,
    /// The same of one address; of IPv6, of the 2^64 that one customer has. Behind a proxy all clients have its address.
    pub connections_per_address_max: NonZeroUsize,
    /// Seconds that a TLS handshake may take.
    pub handshake_timeout_seconds: NonZeroU64,
    /// Seconds that the head of a request may take to arrive.
    pub head_timeout_seconds: NonZeroU64,
    /// Seconds that a connection may stay without a request.
    pub idle_timeout_seconds: NonZeroU64,
    /// Seconds that a client may leave what is answered unread.
    pub unread_timeout_seconds: NonZeroU64,
    /// Data directory.
    pub data: PathBuf,
    /// File of the keys of those who may ask; without it everybody may do everything.
    pub keys: Option<PathBuf>,
    /// Names that the server goes by, besides its addresses and those of loopback.
    #[serde(default)]
    pub allowed_host: Vec<HostName>,
    /// Origins of others whose pages may ask.
    #[serde(default)]
    pub allow_origin: Vec<Origin>,
    /// Listen where others reach it though there are no keys or no TLS.
    pub insecure: bool,
    /// Changes that may wait in one scene's queue; more are answered 429.
    pub queue_changes_max: NonZeroUsize,
    /// Operations that one commit takes together.
    pub group_operations_max: NonZeroUsize,
    /// Bytes of a request's body; more are answered 413. Streams are not limited.
    pub body_bytes_max: NonZeroUsize,
    /// Cubes of one change; more are answered 413.
    pub change_cubes_max: NonZeroUsize,
    /// Bytes of memory that requests and audits share, fairly; what finds none is answered 429. Not what the scenes take.
    pub memory_bytes_max: NonZeroU64,
    /// Most scenes; more are answered 507.
    pub scenes_max: NonZeroUsize,
    /// Free bytes where the data is below which changes are answered 507; everything can still be read.
    pub disk_free_bytes_min: u64,
    /// Newest changes whose totals are kept, per scene.
    pub history_changes_max: NonZeroU64,
    /// Newest idempotency keys kept, per scene.
    pub idempotency_keys_max: NonZeroU64,
    /// Newest changes of a scene that can be reverted once there is a snapshot.
    pub revert_changes_max: u64,
    /// Most bytes kept for that, per scene.
    pub revert_bytes_max: u64,
    /// Seconds that a body may take to arrive, and an answer to be made; of a stream, how long it may pause.
    pub request_timeout_seconds: NonZeroU64,
    /// Seconds that `?wait=` waits.
    pub wait_seconds_max: NonZeroU64,
    /// Seconds between two tries of a disk that has failed.
    pub probe_interval_seconds: NonZeroU64,
    /// How log lines look.
    pub log_format: LogFormat,
    /// Which log lines are written: `info`, `union3d=debug,warn`, ...
    pub log_filter: String,
}

/// What the command line sets; what it leaves out comes from elsewhere.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, clap::Args)]
pub struct ServeFlags {
    /// Address that HTTP listens on; port 0 picks a free one [default: 127.0.0.1:7373]
    #[arg(long, value_name = "ADDRESS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub http: Option<ListenAddress>,
    /// Address that gRPC listens on; port 0 picks a free one [default: 127.0.0.1:7374]
    #[arg(long, value_name = "ADDRESS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grpc: Option<ListenAddress>,
    /// The server's TLS certificate and those that lead to its authority, as PEM; with it all connections are encrypted
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_certificate: Option<PathBuf>,
    /// Its private key, as PEM
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_key: Option<PathBuf>,
    /// The authorities, as PEM, of which every client must have a certificate
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_client_ca: Option<PathBuf>,
    /// Seconds between two looks at these files; what is new in them holds from the next connection on [default: 10]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls_renewal_seconds: Option<NonZeroU64>,
    /// Connections at a time, of HTTP and gRPC together; further ones are closed at once [default: 1024]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub connections_max: Option<NonZeroUsize>,
    /// The same of one address; behind a proxy all clients have its address [default: 256]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub connections_per_address_max: Option<NonZeroUsize>,
    /// Seconds that a TLS handshake may take [default: 10]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub handshake_timeout_seconds: Option<NonZeroU64>,
    /// Seconds that the head of a request may take to arrive [default: 10]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub head_timeout_seconds: Option<NonZeroU64>,
    /// Seconds that a connection may stay without a request [default: 300]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub idle_timeout_seconds: Option<NonZeroU64>,
    /// Seconds that a client may leave what is answered unread [default: 60]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unread_timeout_seconds: Option<NonZeroU64>,
    /// Data directory; created when it is not there [default: union3d-data]
    #[arg(long, value_name = "DIRECTORY")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data: Option<PathBuf>,
    /// File of the keys of those who may ask (`union3d key new` makes one); read again when it changes [default: everybody may do everything]
    #[arg(long, value_name = "FILE")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keys: Option<PathBuf>,
    /// A name that the server goes by, such as union3d.example, besides its addresses and those of loopback; may be given several times
    #[arg(long, value_name = "NAME")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allowed_host: Vec<HostName>,
    /// Let pages of this origin ask, such as <http://localhost:3000>; may be given several times
    #[arg(long, value_name = "ORIGIN")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub allow_origin: Vec<Origin>,
    /// Listen on addresses that others reach though there are no keys or no TLS: something else must keep strangers out
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub insecure: bool,
    /// Changes that may wait in one scene's queue [default: 1024]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub queue_changes_max: Option<NonZeroUsize>,
    /// Operations that one commit takes together [default: 65536]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group_operations_max: Option<NonZeroUsize>,
    /// Bytes of a request's body; streams are not limited [default: 67108864]
    #[arg(long, value_name = "BYTES")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub body_bytes_max: Option<NonZeroUsize>,
    /// Cubes of one change [default: 1000000]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_cubes_max: Option<NonZeroUsize>,
    /// Bytes of memory that requests and audits share, fairly; not what the scenes take [default: a quarter of the machine's or the
    /// container's]
    #[arg(long, value_name = "BYTES")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory_bytes_max: Option<NonZeroU64>,
    /// Most scenes [default: 10000]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scenes_max: Option<NonZeroUsize>,
    /// Free bytes where the data is below which changes are refused [default: 268435456]
    #[arg(long, value_name = "BYTES")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub disk_free_bytes_min: Option<u64>,
    /// Newest changes whose totals are kept, per scene [default: 10000000]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub history_changes_max: Option<NonZeroU64>,
    /// Newest idempotency keys kept, per scene [default: 100000]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub idempotency_keys_max: Option<NonZeroU64>,
    /// Newest changes of a scene that can be reverted once there is a snapshot [default: 1000000]
    #[arg(long, value_name = "COUNT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revert_changes_max: Option<u64>,
    /// Most bytes kept for that, per scene [default: 1073741824]
    #[arg(long, value_name = "BYTES")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revert_bytes_max: Option<u64>,
    /// Seconds that a body may take to arrive, and an answer to be made; of a stream, how long it may pause [default: 30]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub request_timeout_seconds: Option<NonZeroU64>,
    /// Seconds that ?wait= waits [default: 10]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wait_seconds_max: Option<NonZeroU64>,
    /// Seconds between two tries of a disk that has failed [default: 1]
    #[arg(long, value_name = "SECONDS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probe_interval_seconds: Option<NonZeroU64>,
    /// How log lines look [default: text]
    #[arg(long, value_name = "FORMAT")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_format: Option<LogFormat>,
    /// Which log lines are written: info, or union3d=debug,warn, ... [default: info]
    #[arg(long, value_name = "FILTER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log_filter: Option<String>,
}

/// Why the settings cannot be used: names the key and where it was set.
#[derive(Debug, thiserror::Error)]
#[error("configuration: {0}")]
pub struct InvalidConfig(#[from] ConfigError);

impl InvalidConfig {
    fn of(what: String) -> Self {
        Self(ConfigError::Message(what))
    }
}

/// An example of the file: every setting with what it means and its default, all commented out. One whose default is none, or that of the
/// machine, stands without a value.
pub fn example() -> String {
    let defaults = serde_json::to_value(ServeConfig::default());
    let mut defaults = defaults.expect("settings are an object of JSON");
    let mut text = format!(
        "# Settings of union3d {}, of `union3d serve --config FILE`. Each is also a variable, such as UNION3D_HTTP, and a flag, --http:\n\
         # flags win over variables, and variables over this file. What stands here are the defaults.\n",
        env!("CARGO_PKG_VERSION")
    );
    let command = ServeFlags::augment_args(clap::Command::new("serve"));
    for flag in command.get_arguments() {
        let key = flag.get_id().as_str();
        let help = flag.get_help().map(ToString::to_string).unwrap_or_default();
        let (meaning, default) = match help.split_once(" [default: ") {
            Some((meaning, default)) => (meaning.to_owned(), default.trim_end_matches(']')),
            None => (help, ""),
        };
        let value = defaults[key].take();
        let shown = match &value {
            serde_json::Value::Null => None,
            // What depends on the machine is said in words.
            serde_json::Value::Number(number) if number.to_string() != default => None,
            value => Some(value),
        };
        let names = flag.get_value_names().unwrap_or_default();
        let value = match shown {
            // A scalar or a list is written the same in JSON and TOML.
            Some(value) => value.to_string(),
            None => names.iter().map(clap::builder::Str::as_str).collect(),
        };
        let note = if shown.is_none() && !default.is_empty() {
            format!(
                " Default: {}.",
                default.split_whitespace().collect::<Vec<_>>().join(" ")
            )
        } else {
            String::new()
        };
        writeln!(
            text,
            "\n# {}.{note}\n#{key} = {value}",
            meaning.trim_end_matches('.')
        )
        .expect("a string takes everything");
    }
    text
}

/// What the names of variables begin with.
const PREFIX: &str = "UNION3D_";

/// The keys of all settings.
fn keys() -> BTreeSet<String> {
    // Not of a `Config`, which drops lists that are empty.
    match serde_json::to_value(ServeConfig::default()) {
        Ok(serde_json::Value::Object(settings)) => {
            settings.into_iter().map(|(key, _)| key).collect()
        }
        _ => unreachable!("settings are an object of JSON"),
    }
}

/// Whether a variable is none of the server's, by what follows the prefix: that of another command, or one of those that Kubernetes
/// sets for services whose name begins with union3d.
fn is_of_others(key: &str) -> bool {
    ["CONFIG", "KEY"].contains(&key)
        || key.ends_with("SERVICE_HOST")
        || key.contains("SERVICE_PORT")
        || key == "PORT"
        || key.starts_with("PORT_")
        || key.ends_with("_PORT")
        || key.contains("_PORT_")
}

/// Refuses a file with a key that is no setting, with its line. A file that cannot be read or parsed is refused by who takes it.
fn check_keys(file: &Path, known: &BTreeSet<String>) -> Result<(), InvalidConfig> {
    let text = std::fs::read_to_string(file).unwrap_or_default();
    let Ok(table) = toml::de::DeTable::parse(&text) else {
        return Ok(());
    };
    let mut unknown: Vec<_> = table.get_ref().keys().collect();
    unknown.retain(|key| !known.contains(key.get_ref().as_ref()));
    let Some(first) = unknown.into_iter().min_by_key(|key| key.span().start) else {
        return Ok(());
    };
    let line = text[..first.span().start].matches('\n').count() + 1;
    Err(InvalidConfig::of(format!(
        "{}, line {line}: {} is no setting; `union3d serve --help` lists them",
        file.display(),
        first.get_ref()
    )))
}

impl Default for ServeConfig {
    fn default() -> Self {
        const fn count(count: usize) -> NonZeroUsize {
            NonZeroUsize::new(count).expect("a default is not zero")
        }
        const fn whole(number: u64) -> NonZeroU64 {
            NonZeroU64::new(number).expect("a default is not zero")
        }
        Self {
            http: SocketAddr::from(([127, 0, 0, 1], 7373)).into(),
            grpc: SocketAddr::from(([127, 0, 0, 1], 7374)).into(),
            tls_certificate: None,
            tls_key: None,
            tls_client_ca: None,
            tls_renewal_seconds: whole(10),
            connections_max: count(1024),
            connections_per_address_max: count(256),
            handshake_timeout_seconds: whole(10),
            head_timeout_seconds: whole(10),
            idle_timeout_seconds: whole(300),
            unread_timeout_seconds: whole(60),
            data: "union3d-data".into(),
            keys: None,
            allowed_host: vec![],
            allow_origin: vec![],
            insecure: false,
            queue_changes_max: count(1024),
            group_operations_max: count(65_536),
            body_bytes_max: count(64 << 20),
            change_cubes_max: count(1_000_000),
            memory_bytes_max: NonZeroU64::new(
                memory_limit_bytes().unwrap_or(UNKNOWN_MEMORY_BYTES) / 4,
            )
            .unwrap_or(NonZeroU64::MIN),
            scenes_max: count(10_000),
            disk_free_bytes_min: 256 << 20,
            history_changes_max: whole(10_000_000),
            idempotency_keys_max: whole(100_000),
            revert_changes_max: 1_000_000,
            revert_bytes_max: 1 << 30,
            request_timeout_seconds: whole(30),
            wait_seconds_max: whole(10),
            probe_interval_seconds: whole(1),
            log_format: LogFormat::Text,
            log_filter: "info".to_owned(),
        }
    }
}

/// What is taken for the memory of a machine that does not tell.
const UNKNOWN_MEMORY_BYTES: u64 = 4 << 30;

impl ServeConfig {
    /// Reads the settings of this process.
    /// # Errors
    /// [`InvalidConfig`]: a file that cannot be read, a key it should not have, a value out of range.
    pub fn load(file: Option<&Path>, flags: &ServeFlags) -> Result<Self, InvalidConfig> {
        // Not `vars()`: a variable of somebody else's that is not UTF-8 is none of our business.
        let variables = std::env::vars_os().filter_map(|(name, value)| {
            Some((name.into_string().ok()?, value.into_string().ok()?))
        });
        Self::merge(file, variables, flags)
    }

    /// As [`ServeConfig::load`], with the environment given.
    /// # Errors
    /// As [`ServeConfig::load`].
    pub fn merge(
        file: Option<&Path>,
        variables: impl IntoIterator<Item = (String, String)>,
        flags: &ServeFlags,
    ) -> Result<Self, InvalidConfig> {
        let defaults = Config::try_from(&Self::default())?;
        let known = keys();
        let mut ours = Map::new();
        for (name, value) in variables {
            let Some(key) = name.strip_prefix(PREFIX) else {
                continue;
            };
            if known.contains(&key.to_lowercase()) {
                ours.insert(name, value);
            } else if !is_of_others(key) {
                return Err(InvalidConfig::of(format!(
                    "the environment variable {name} is no setting; `union3d serve --help` lists them"
                )));
            }
        }
        let environment = Environment::with_prefix("UNION3D")
            .try_parsing(true)
            .ignore_empty(true)
            .list_separator(",")
            .with_list_parse_key("allowed_host")
            .with_list_parse_key("allow_origin")
            .source(Some(ours));
        let mut builder = Config::builder().add_source(defaults);
        if let Some(file) = file {
            check_keys(file, &known)?;
            builder = builder.add_source(File::from(file).format(FileFormat::Toml));
        }
        let merged = builder
            .add_source(environment)
            .add_source(Config::try_from(flags)?)
            .build()?;
        let config: Self = merged.try_deserialize()?;
        if config.change_cubes_max.get() > CHANGE_OPERATIONS_MAX {
            return Err(InvalidConfig::of(format!(
                "change_cubes_max is {}; the most is {CHANGE_OPERATIONS_MAX}",
                config.change_cubes_max
            )));
        }
        if let Some(missing) = config.missing_for_tls() {
            return Err(InvalidConfig::of(missing.to_owned()));
        }
        Ok(config)
    }

    /// What encryption needs and is not set.
    fn missing_for_tls(&self) -> Option<&'static str> {
        match (&self.tls_certificate, &self.tls_key, &self.tls_client_ca) {
            (Some(_), None, _) => Some("tls_certificate is set, and tls_key is not"),
            (None, Some(_), _) => Some("tls_key is set, and tls_certificate is not"),
            (None, None, Some(_)) => {
                Some("tls_client_ca is set, and tls_certificate and tls_key are not")
            }
            _ => None,
        }
    }

    /// Where certificates are, when connections are to be encrypted.
    pub fn certificates(&self) -> Option<CertificateFiles> {
        Some(CertificateFiles {
            certificate: self.tls_certificate.clone()?,
            key: self.tls_key.clone()?,
            client_ca: self.tls_client_ca.clone(),
        })
    }

    /// The part that the door needs.
    pub fn door(&self) -> door::Settings {
        let seconds = |number: NonZeroU64| Duration::from_secs(number.get());
        door::Settings {
            connections_max: self.connections_max.get(),
            connections_per_address_max: self.connections_per_address_max.get(),
            handshake_timeout: seconds(self.handshake_timeout_seconds),
            head_timeout: seconds(self.head_timeout_seconds),
            idle_timeout: seconds(self.idle_timeout_seconds),
            unread_timeout: seconds(self.unread_timeout_seconds),
        }
    }

    /// The part that the service needs.
    pub fn service(&self) -> ServiceConfig {
        ServiceConfig {
            queue_changes_max: self.queue_changes_max.get(),
            group_operations_max: self.group_operations_max.get(),
            history_changes_max: self.history_changes_max.get(),
            idempotency_keys_max: self.idempotency_keys_max.get(),
            revert_changes_max: self.revert_changes_max,
            revert_bytes_max: self.revert_bytes_max,
            memory_bytes_max: self.memory_bytes_max.get(),
            scenes_max: self.scenes_max.get(),
            disk_free_bytes_min: self.disk_free_bytes_min,
            probe_interval: Duration::from_secs(self.probe_interval_seconds.get()),
            ..ServiceConfig::new(&self.data)
        }
    }
}
