//! Whose pages may ask: the names that this server goes by, and the origins of pages.
//!
//! A page that a browser has from anywhere can ask any address that the browser reaches, under a name that its own server
//! has pointed there ("DNS rebinding"); the browser takes the answers for the page's own. All that tells such a request is the name in
//! its `Host` header (`:authority` in HTTP/2). An address there is no name that somebody else could have pointed here.

use std::net::IpAddr;
use std::str::FromStr;

use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Uri, header};

use crate::wire::problem::{Code, Problem};

/// Who may be asked for, and who may ask.
#[derive(Clone, Debug, Default)]
pub struct Hosts {
    listening: Vec<IpAddr>,
    names: Vec<HostName>,
    origins: Vec<Origin>,
}

/// A name that this server goes by, without a port.
#[derive(Clone, PartialEq, Eq, Debug, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct HostName(String);

impl FromStr for HostName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let no_name =
            || format!("{text:?} is no name of a host, such as union3d.example, or an address");
        let authority = Authority::from_str(text).map_err(|_| no_name())?;
        // Without a port and without a user.
        if authority.as_str() != authority.host() || text.contains('*') {
            return Err(no_name());
        }
        Ok(Self(bare(authority.host())))
    }
}

impl TryFrom<String> for HostName {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<HostName> for String {
    fn from(name: HostName) -> Self {
        name.0
    }
}

/// Where a page comes from: a scheme, a host and a port.
#[derive(Clone, PartialEq, Eq, Debug, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Origin {
    /// As browsers send it.
    text: String,
    scheme: Scheme,
    host: String,
    port: u16,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Scheme {
    Http,
    Https,
}

impl Scheme {
    fn port(self) -> u16 {
        match self {
            Self::Http => 80,
            Self::Https => 443,
        }
    }
}

impl Origin {
    /// As a header has it.
    pub(in crate::wire) fn value(&self) -> HeaderValue {
        HeaderValue::from_str(&self.text).expect("a host has visible characters only")
    }
}

impl FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let no_origin = || format!("{text:?} is no origin, such as http://localhost:3000");
        let lower = text.to_ascii_lowercase();
        let (scheme, rest) = lower.split_once("://").ok_or_else(no_origin)?;
        let scheme = match scheme {
            "http" => Scheme::Http,
            "https" => Scheme::Https,
            _ => return Err(no_origin()),
        };
        let authority = Authority::from_str(rest).map_err(|_| no_origin())?;
        if rest.contains(['@', '*']) || authority.host().is_empty() {
            return Err(no_origin());
        }
        let port = authority.port_u16().unwrap_or(scheme.port());
        let (name, shown_port) = (authority.host(), port != scheme.port());
        let shown_scheme = if scheme == Scheme::Http {
            "http"
        } else {
            "https"
        };
        Ok(Self {
            text: if shown_port {
                format!("{shown_scheme}://{name}:{port}")
            } else {
                format!("{shown_scheme}://{name}")
            },
            scheme,
            host: bare(name),
            port,
        })
    }
}

impl TryFrom<String> for Origin {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Origin> for String {
    fn from(origin: Origin) -> Self {
        origin.text
    }
}

/// A host in the one way in which it is compared: small letters, no brackets, no dot at its end.
fn bare(host: &str) -> String {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host.trim_end_matches('.').to_ascii_lowercase()
}

impl Hosts {
    /// A server that listens at these addresses, goes by these names, and is asked by pages of these origins.
    pub fn new(listening: Vec<IpAddr>, names: Vec<HostName>, origins: Vec<Origin>) -> Self {
        Self {
            listening,
            names,
            origins,
        }
    }

    /// The origins of others whose pages may ask.
    pub(in crate::wire) fn origins(&self) -> &[Origin] {
        &self.origins
    }

    /// Checks who was asked for, and whose page asks.
    pub(super) fn check(&self, uri: &Uri, headers: &HeaderMap) -> Result<(), Problem> {
        let mut asked = Vec::new();
        for host in headers.get_all(header::HOST) {
            let text = host.to_str().unwrap_or_default();
            let authority = Authority::from_str(text).map_err(|_| {
                Problem::new(
                    Code::BadRequest,
                    "the Host header is not a host with or without a port",
                )
            })?;
            asked.push(authority);
        }
        if asked.len() > 1 {
            return Err(Problem::new(
                Code::BadRequest,
                "there are several Host headers",
            ));
        }
        // HTTP/2 has the name here, and of HTTP/1.1 what goes by way of a proxy.
        asked.extend(uri.authority().cloned());
        let Some(first) = asked.first() else {
            return Err(Problem::new(Code::BadRequest, "there is no Host header"));
        };
        if let Some(strange) = asked.iter().find(|authority| !self.is_ours(authority)) {
            let detail = format!(
                "this server does not go by the name {:?}; --allowed-host makes it one of its names",
                strange.host()
            );
            return Err(Problem::new(Code::HostNotAllowed, detail));
        }
        self.check_origin(first, headers)
    }

    fn is_ours(&self, authority: &Authority) -> bool {
        if authority.as_str().contains('@') {
            return false;
        }
        let host = bare(authority.host());
        if let Ok(address) = host.parse::<IpAddr>() {
            let listens = |listening: &IpAddr| listening.is_unspecified() || *listening == address;
            return address.is_loopback() || self.listening.iter().any(listens) || self.has(&host);
        }
        host == "localhost" || host.ends_with(".localhost") || self.has(&host)
    }

    fn has(&self, host: &str) -> bool {
        self.names.iter().any(|name| name.0 == host)
    }

    /// Whether the page that asks, if one does, is of this server or of an origin that was allowed.
    fn check_origin(&self, asked: &Authority, headers: &HeaderMap) -> Result<(), Problem> {
        for sent in headers.get_all(header::ORIGIN) {
            let text = sent.to_str().unwrap_or_default();
            let fits = text.parse::<Origin>().is_ok_and(|origin| {
                let port = asked.port_u16().unwrap_or(origin.scheme.port());
                let is_own = origin.host == bare(asked.host()) && origin.port == port;
                is_own || self.origins.contains(&origin)
            });
            if !fits {
                let detail =
                    "a page of another origin asks; --allow-origin lets pages of an origin in";
                return Err(Problem::new(Code::OriginNotAllowed, detail));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(hosts: &Hosts, host: &str, origin: Option<&str>) -> Option<Code> {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().unwrap());
        }
        let checked = hosts.check(&Uri::from_static("/"), &headers);
        checked.err().map(|problem| problem.code())
    }

    #[test]
    fn a_strangers_host_is_told_from_ours() {
        let of = |addresses: &[&str]| {
            let listening = addresses.iter().map(|one| one.parse().unwrap()).collect();
            Hosts::new(listening, vec!["Union3D.Example.".parse().unwrap()], vec![])
        };
        let loopback = of(&["127.0.0.1"]);
        for host in [
            "127.0.0.1:7373",
            "127.0.0.1",
            "localhost",
            "LocalHost:1",
            "localhost.",
            "a.localhost",
            "[::1]:7373",
            "union3d.example",
            "UNION3D.example:8443",
            "127.0.0.2",
        ] {
            assert_eq!(asked(&loopback, host, None), None, "{host}");
        }
        for host in [
            "evil.example",
            "union3d.example.evil.example",
            "localhost.evil.example",
            "192.168.0.9",
            "0.0.0.0",
            "evil.example@localhost",
            "notlocalhost",
            "[fe80::1]",
        ] {
            assert_eq!(
                asked(&loopback, host, None),
                Some(Code::HostNotAllowed),
                "{host}"
            );
        }
        assert_eq!(asked(&of(&["192.168.0.9"]), "192.168.0.9:1", None), None);
        // Whoever listens on all addresses has all of them.
        assert_eq!(asked(&of(&["0.0.0.0"]), "10.1.2.3:7373", None), None);
        assert_eq!(
            asked(&of(&["0.0.0.0"]), "evil.example", None),
            Some(Code::HostNotAllowed)
        );
    }

    #[test]
    fn one_host_is_sent_and_the_one_in_the_address_counts_too() {
        let hosts = Hosts::default();
        let check = |uri: &'static str, sent: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for host in sent {
                headers.append(header::HOST, HeaderValue::from_static(host));
            }
            let checked = hosts.check(&Uri::from_static(uri), &headers);
            checked.err().map(|problem| problem.code())
        };
        assert_eq!(check("/", &["localhost"]), None);
        assert_eq!(check("http://localhost/", &[]), None);
        assert_eq!(check("/", &[]), Some(Code::BadRequest));
        assert_eq!(
            check("/", &["localhost", "localhost"]),
            Some(Code::BadRequest)
        );
        assert_eq!(check("/", &["a b"]), Some(Code::BadRequest));
        assert_eq!(
            check("http://evil.example/", &["localhost"]),
            Some(Code::HostNotAllowed)
        );
        assert_eq!(
            check("http://localhost/", &["evil.example"]),
            Some(Code::HostNotAllowed)
        );
    }

    #[test]
    fn pages_of_this_server_and_of_allowed_origins_may_ask() {
        let origins = vec!["http://localhost:3000".parse().unwrap()];
        let hosts = Hosts::new(vec![], vec!["union3d.example".parse().unwrap()], origins);
        for (host, origin, is_fine) in [
            ("127.0.0.1:7373", "http://127.0.0.1:7373", true),
            ("union3d.example", "https://union3d.example", true),
            ("union3d.example", "http://union3d.example", true),
            ("union3d.example", "https://UNION3D.example:443", true),
            ("127.0.0.1:7373", "http://localhost:3000", true),
            ("127.0.0.1:7373", "http://localhost:3001", false),
            ("127.0.0.1:7373", "https://localhost:3000", false),
            ("127.0.0.1:7373", "http://localhost:7373", false),
            ("127.0.0.1:7373", "null", false),
            ("127.0.0.1:7373", "http://evil.example", false),
            ("127.0.0.1:7373", "chrome-extension://abc", false),
            ("union3d.example", "http://union3d.example:8080", false),
        ] {
            let refused = (!is_fine).then_some(Code::OriginNotAllowed);
            assert_eq!(
                asked(&hosts, host, Some(origin)),
                refused,
                "{host} {origin}"
            );
        }
    }

    #[test]
    fn names_and_origins_that_cannot_be_are_refused() {
        for name in ["", "a:80", "http://a", "*", "*.a", "u@a", "a/b"] {
            assert!(name.parse::<HostName>().is_err(), "{name}");
        }
        for origin in [
            "",
            "*",
            "null",
            "localhost:3000",
            "http://",
            "http://a/",
            "http://a/b",
            "ftp://a",
            "http://*.a",
        ] {
            assert!(origin.parse::<Origin>().is_err(), "{origin}");
        }
        let origin: Origin = "HTTP://LocalHost:80".parse().unwrap();
        assert_eq!(origin.value(), "http://localhost");
    }
}
