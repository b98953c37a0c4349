//! The gRPC API, from outside: a real server, a real client; HTTP beside it on the same service.

mod access;
mod calls;
#[path = "../oracle/keys.rs"]
mod keys;
mod memory;
mod operation;
mod refusals;
mod server;
mod solids;
#[path = "../oracle/stop.rs"]
mod stop;
mod streams;
