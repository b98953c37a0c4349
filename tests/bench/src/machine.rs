//! What a measurement was taken on: without it a figure means nothing.

use std::path::Path;

use serde::Serialize;

use super::figures::float;

/// The machine, the program and how it was called.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Machine {
    processor: String,
    cores: usize,
    vectors: &'static str,
    memory_gib: f64,
    kernel: String,
    /// Processes that wanted to run in the last minute, on average, before the measurement: above zero it was not alone.
    load_before: f64,
    version: &'static str,
    build: &'static str,
    command: String,
}

impl Machine {
    /// This one, now.
    pub(crate) fn new() -> Self {
        let command: Vec<String> = std::env::args().skip(1).collect();
        Self {
            processor: field("/proc/cpuinfo", "model name").unwrap_or_else(|| "unknown".to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            vectors: vectors(),
            memory_gib: kibibytes("/proc/meminfo", "MemTotal")
                .map_or(f64::NAN, |kibibytes| float(kibibytes) / 1_048_576.0),
            kernel: read("/proc/sys/kernel/osrelease").trim().to_owned(),
            load_before: read("/proc/loadavg")
                .split(' ')
                .next()
                .and_then(|load| load.parse().ok())
                .unwrap_or(f64::NAN),
            version: env!("CARGO_PKG_VERSION"),
            build: if cfg!(debug_assertions) {
                "debug"
            } else {
                "release"
            },
            command: format!("union3d-bench {}", command.join(" ")),
        }
    }

    /// Two lines to be put above a table.
    pub(crate) fn markdown(&self) -> String {
        format!(
            "{} ({} cores, {}), {:.1} GiB, Linux {}, load before {:.2}; union3d {} ({})\n\n    {}\n",
            self.processor,
            self.cores,
            self.vectors,
            self.memory_gib,
            self.kernel,
            self.load_before,
            self.version,
            self.build,
            self.command,
        )
    }
}

/// The widest vectors that the kernel could choose.
fn vectors() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    {
        if std::arch::is_x86_feature_detected!("avx512bw") {
            return "AVX-512";
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            return "AVX2";
        }
    }
    std::env::consts::ARCH
}

/// Resident memory of a process and its greatest so far. Units: bytes. Zero where the system does not tell.
#[derive(Clone, Copy, Debug, Default, Serialize, serde::Deserialize)]
pub(crate) struct Resident {
    pub(crate) now: u64,
    pub(crate) peak: u64,
}

/// Of the process with this id.
pub(crate) fn resident(process: u32) -> Resident {
    let status = format!("/proc/{process}/status");
    let of = |name| kibibytes(&status, name).unwrap_or(0) * 1024;
    Resident {
        now: of("VmRSS"),
        peak: of("VmHWM"),
    }
}

/// The kind of file system a directory is on and its device.
pub(crate) fn file_system(directory: &Path) -> String {
    let directory = directory.canonicalize().unwrap_or_default();
    let mounts = read("/proc/self/mounts");
    let found = mounts
        .lines()
        .filter_map(|line| {
            let mut words = line.split(' ');
            Some((words.next()?, words.next()?, words.next()?))
        })
        .filter(|(_, point, _)| directory.starts_with(point))
        // The longest is the innermost; of two at one place the later hides the earlier.
        .max_by_key(|(_, point, _)| point.len());
    found.map_or_else(
        || "unknown".to_owned(),
        |(device, _, kind)| format!("{kind} on {device}"),
    )
}

fn read(path: &str) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// The value of the first line `name : value`.
fn field(path: &str, name: &str) -> Option<String> {
    let text = read(path);
    let mut lines = text.lines().filter_map(|line| line.split_once(':'));
    let found = lines.find(|(found, _)| found.trim() == name);
    found.map(|(_, value)| value.trim().to_owned())
}

fn kibibytes(path: &str, name: &str) -> Option<u64> {
    field(path, name)?.trim_end_matches(" kB").parse().ok()
}
