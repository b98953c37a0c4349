//! Power cuts and failing disks: whatever a disk does, nothing acknowledged is lost, no total is wrong, no intact scene is
//! refused.
//!
//! ```text
//!   workload ──> service, log ──> disk: every file call, recorded ──> image: what a power cut may leave of it ──> recovery
//! ```
#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

mod calls;
mod disk;
mod faults;
mod image;
mod kinds;
mod power;
mod sequences;
mod workload;

#[path = "../oracle/bodies.rs"]
mod bodies;
#[path = "../oracle/random.rs"]
mod random;

use random::Random;
