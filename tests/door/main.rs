//! How connections come in: TLS, limits, floods, and what can be read in two ways; with raw sockets, since no honest client does
//! most of it.

mod certificates;
mod floods;
mod limits;
mod server;
mod smuggling;
#[path = "../oracle/stop.rs"]
mod stop;
mod streams;
mod tls;
