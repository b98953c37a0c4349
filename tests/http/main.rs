//! The HTTP API as its clients meet it: a real server on a free port of this machine, spoken to with a real client.

mod access;
mod changes;
mod described;
mod description;
mod golden;
mod ids;
#[path = "../oracle/keys.rs"]
mod keys;
mod memory;
mod mesh;
#[path = "../oracle/random.rs"]
mod random;
mod reads;
mod refusals;
mod revert;
mod scenes;
mod server;
mod simulation;
mod solids;
#[path = "../oracle/stop.rs"]
mod stop;
mod streams;
