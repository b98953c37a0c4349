//! The page for people, at `/`, `/scenes/{scene}` and `/problems/{code}`: files that are built from `deploy/page`, in the binary.
//!
//! The page asks the API as everybody does, with a key that its user gives it; so it needs none itself. It runs no script and takes no
//! style, picture or address but the server's own, and no other page may frame it.

use std::sync::LazyLock;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::map_response;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use headers::{ETag, HeaderMapExt, IfNoneMatch};
use sha2::{Digest, Sha256};

use super::request::{Path, VARY};
use super::{App, Route};
use crate::wire::problem::Problem;

/// What the page may load: what this server serves. Pictures and downloads are made in the page, as blobs.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

/// A file of the page.
struct File {
    name: &'static str,
    kind: &'static str,
    bytes: &'static [u8],
}

macro_rules! file {
    ($name:literal, $kind:literal) => {
        File {
            name: $name,
            kind: $kind,
            bytes: include_bytes!(concat!("../../../deploy/page/dist/", $name)),
        }
    };
}

const INDEX: File = file!("index.html", "text/html; charset=utf-8");

const ASSETS: [File; 3] = [
    file!("assets/page.js", "text/javascript; charset=utf-8"),
    file!("assets/page.css", "text/css; charset=utf-8"),
    file!("assets/page.svg", "image/svg+xml"),
];

/// The routes of the page. They are no calls of the API, and not in its description.
pub(super) fn routes() -> Vec<Route> {
    vec![
        ("/", get(get_page)),
        ("/scenes/{scene}", get(get_page)),
        ("/assets/{file}", get(get_asset)),
    ]
}

/// The page itself; which view of it is shown the page takes from its address.
pub(super) async fn get_page(headers: HeaderMap) -> Response {
    INDEX.answer(&headers)
}

async fn get_asset(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let path = format!("assets/{name}");
    let found = ASSETS.iter().find(|file| file.name == path);
    found
        .map(|file| file.answer(&headers))
        .ok_or_else(|| super::no_such_path(&format!("/{path}")))
}

/// The pages that describe the API, with this project's title and the way to its own page.
pub(super) fn described(pages: Router<App>) -> Router<App> {
    pages.layer(map_response(titled))
}

async fn titled(response: Response) -> Response {
    const PAGE_BYTES_MAX: usize = 1 << 20;
    let kind = response.headers().get(header::CONTENT_TYPE);
    if !kind.is_some_and(|kind| kind.as_bytes().starts_with(b"text/html")) {
        return response;
    }
    let (mut parts, body) = response.into_parts();
    let Ok(bytes) = to_bytes(body, PAGE_BYTES_MAX).await else {
        return StatusCode::INTERNAL_SERVER_ERROR.into_response();
    };
    let text = String::from_utf8_lossy(&bytes)
        .replace(
            "<title>Swagger UI</title>",
            "<title>union3d: its API</title>",
        )
        .replace(
            "<body>",
            "<body>\n<p><a href=\"/\">The scenes of this server</a></p>",
        );
    // Both were those of the text before.
    parts.headers.remove(header::CONTENT_LENGTH);
    parts.headers.remove(header::ETAG);
    Response::from_parts(parts, Body::from(text))
}

impl File {
    /// The file, or that it is the one that the client has. Its name stays when it changes, so it is asked for again each time.
    fn answer(&self, headers: &HeaderMap) -> Response {
        let known: Option<IfNoneMatch> = headers.typed_get();
        let tag = Self::tag();
        let is_known = known.is_some_and(|known| !known.precondition_passes(&tag));
        let mut about = HeaderMap::new();
        about.typed_insert(tag);
        about.extend([
            (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
            (header::CONTENT_SECURITY_POLICY, POLICY),
            (
                header::REFERRER_POLICY,
                HeaderValue::from_static("no-referrer"),
            ),
            (OPENER_POLICY, HeaderValue::from_static("same-origin")),
        ]);
        about.extend(VARY);
        if is_known {
            return (StatusCode::NOT_MODIFIED, about).into_response();
        }
        about.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.kind));
        (about, self.bytes).into_response()
    }

    /// Weak, since the file is sent compressed or not. All files are of one build, so that all have the tag of all.
    fn tag() -> ETag {
        static TAG: LazyLock<String> = LazyLock::new(|| {
            let hasher = Sha256::new_with_prefix(INDEX.bytes);
            let hasher = ASSETS
                .iter()
                .fold(hasher, |hasher, file| hasher.chain_update(file.bytes));
            let digest: [u8; 32] = hasher.finalize().into();
            let start = *digest.first_chunk().expect("a digest has 32 bytes");
            format!("{:016x}", u64::from_be_bytes(start))
        });
        let tag = format!("W/\"{}\"", *TAG);
        tag.parse().expect("hexadecimal digits")
    }
}

const OPENER_POLICY: HeaderName = HeaderName::from_static("cross-origin-opener-policy");
