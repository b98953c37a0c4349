//! How the server is set up: defaults, then a TOML file, then `UNION3D_*` variables, then flags; the later wins.
//!
//! A key has one name in all four: `queue_changes_max` in the file, `UNION3D_QUEUE_CHANGES_MAX`, `--queue-changes-max`.

use std::net::SocketAddr;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::{Path, PathBuf};
use std::time::Duration;

use config::{Config, ConfigError, Environment, File, FileFormat, Map};
use serde::{Deserialize, Serialize};

use crate::service::{CHANGE_OPERATIONS_MAX, ServiceConfig};

/// How log lines look.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The settings of `union3d serve`.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServeConfig {
    /// Address that HTTP listens on; port 0 picks a free one.
    pub http: SocketAddr,
    /// Address that gRPC listens on; port 0 picks a free one.
    pub grpc: SocketAddr,
    /// Data directory.
    pub data: PathBuf,
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
    pub http: Option<SocketAddr>,
    /// Address that gRPC listens on; port 0 picks a free one [default: 127.0.0.1:7374]
    #[arg(long, value_name = "ADDRESS")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grpc: Option<SocketAddr>,
    /// Data directory; created when it is not there [default: union3d-data]
    #[arg(long, value_name = "DIRECTORY")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub data: Option<PathBuf>,
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

impl Default for ServeConfig {
    fn default() -> Self {
        const fn count(count: usize) -> NonZeroUsize {
            NonZeroUsize::new(count).expect("a default is not zero")
        }
        const fn whole(number: u64) -> NonZeroU64 {
            NonZeroU64::new(number).expect("a default is not zero")
        }
        Self {
            http: SocketAddr::from(([127, 0, 0, 1], 7373)),
            grpc: SocketAddr::from(([127, 0, 0, 1], 7374)),
            data: "union3d-data".into(),
            queue_changes_max: count(1024),
            group_operations_max: count(65_536),
            body_bytes_max: count(64 << 20),
            change_cubes_max: count(1_000_000),
            memory_bytes_max: NonZeroU64::new(memory_bytes() / 4).unwrap_or(NonZeroU64::MIN),
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

/// The memory of the machine, or of the container that this process is in.
fn memory_bytes() -> u64 {
    let Ok(mut system) = sysinfo::System::new() else {
        return UNKNOWN_MEMORY_BYTES;
    };
    system.refresh_memory();
    let of_container = system.cgroup_limits().map(|limits| limits.total_memory);
    of_container.map_or(system.total_memory(), |bytes| {
        bytes.min(system.total_memory())
    })
}

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
        let known: Map<String, config::Value> = defaults.clone().try_deserialize()?;
        // An unknown variable is no error: Kubernetes sets some for a service that is called union3d.
        let variables = variables.into_iter().filter(|(name, _)| {
            name.strip_prefix("UNION3D_")
                .is_some_and(|key| known.contains_key(&key.to_lowercase()))
        });
        let environment = Environment::with_prefix("UNION3D")
            .try_parsing(true)
            .ignore_empty(true)
            .source(Some(variables.collect()));
        let mut builder = Config::builder().add_source(defaults);
        if let Some(file) = file {
            builder = builder.add_source(File::from(file).format(FileFormat::Toml));
        }
        let merged = builder
            .add_source(environment)
            .add_source(Config::try_from(flags)?)
            .build()?;
        let config: Self = merged.try_deserialize()?;
        if config.change_cubes_max.get() > CHANGE_OPERATIONS_MAX {
            return Err(InvalidConfig(ConfigError::Message(format!(
                "change_cubes_max is {}; the most is {CHANGE_OPERATIONS_MAX}",
                config.change_cubes_max
            ))));
        }
        Ok(config)
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
