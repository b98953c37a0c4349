//! What a request says outside its body, and the reading of bodies: everything checked, every failure a problem.

use std::borrow::Cow;
use std::convert::Infallible;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequestParts, Query};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, header};
use futures_util::StreamExt;
use headers::HeaderMapExt;
use headers_accept::Accept;
use mediatype::MediaType;
use utoipa::ToSchema;

use super::{App, Limits};
use crate::service::Share;
use crate::wire::calls;
use crate::wire::documents::{IdForm, decimal};
use crate::wire::problem::{Code, Fault, Faults, Problem};
use crate::wire::room;

/// What is said of the parameter `id` in a path.
pub(super) const ABOUT_ID: &str = "The cube's id: a whole number from 0 to 2^64 - 1, in decimal digits. Where numbers are floats, as in \
                                   JavaScript, keep it as a string: above 2^53 it would be another one";

/// What is said of the parameter `ids`.
pub(super) const ABOUT_IDS: &str =
    "`text`: ids are answered as decimal strings, which JavaScript keeps exact above 2^53";

/// Parameters of the path.
#[derive(FromRequestParts)]
#[from_request(via(axum::extract::Path), rejection(Problem))]
pub(super) struct Path<T>(pub(super) T);

impl From<PathRejection> for Problem {
    fn from(rejection: PathRejection) -> Self {
        Problem::new(Code::BadRequest, rejection.body_text())
    }
}

/// Parameters of the query, as they stand there.
pub(super) struct Parameters(Vec<(String, String)>);

impl<S: Sync> FromRequestParts<S> for Parameters {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let Query(pairs) = Query::try_from_uri(&parts.uri)
            .map_err(|rejection| Problem::new(Code::BadRequest, rejection.body_text()))?;
        Ok(Self(pairs))
    }
}

impl Parameters {
    /// Refuses all parameters but these: a misspelt one would be silently without effect.
    pub(super) fn only(self, known: &[&'static str]) -> Result<Known, Problem> {
        let mut faults = Faults::default();
        for (index, (name, value)) in self.0.iter().enumerate() {
            if !known.contains(&name.as_str()) {
                let detail = match known {
                    [] => "is not known here; there are no parameters".to_owned(),
                    known => format!("is not known here; known are {}", known.join(", ")),
                };
                faults.push(Fault::in_parameter(name.clone(), detail, value));
            } else if self.0[..index].iter().any(|(earlier, _)| earlier == name) {
                faults.push(Fault::in_parameter(name.clone(), "stands twice", value));
            }
        }
        if faults.is_empty() {
            Ok(Known(self.0))
        } else {
            Err(faults.into_problem())
        }
    }
}

/// Parameters of the query, known and each at most once.
pub(super) struct Known(Vec<(String, String)>);

impl Known {
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        let found = self.0.iter().find(|(known, _)| known == name);
        found.map(|(_, value)| value.as_str())
    }

    /// A whole number, if it is given.
    pub(super) fn number(&self, name: &'static str) -> Result<Option<u64>, Problem> {
        self.text(name).map(|text| whole(name, text)).transpose()
    }

    /// A limit from 1 to `max`, if it is given.
    pub(super) fn limit(&self, max: u64) -> Result<Option<u64>, Problem> {
        let Some(text) = self.text("limit") else {
            return Ok(None);
        };
        match decimal(text) {
            Some(limit) if (1..=max).contains(&limit) => Ok(Some(limit)),
            _ => Err(Fault::in_parameter(
                "limit",
                format!("is not a whole number from 1 to {max}"),
                text,
            )
            .into()),
        }
    }

    /// Whether something is wanted: `true` or `false`, which is meant when it is left out.
    pub(super) fn flag(&self, name: &'static str) -> Result<bool, Problem> {
        match self.text(name) {
            None | Some("false") => Ok(false),
            Some("true") => Ok(true),
            Some(other) => {
                let detail = "is neither \"true\" nor \"false\"";
                Err(Fault::in_parameter(name, detail, other).into())
            }
        }
    }

    /// How ids are to be answered.
    pub(super) fn ids(&self) -> Result<IdForm, Problem> {
        match self.text("ids") {
            None | Some("number") => Ok(IdForm::Number),
            Some("text") => Ok(IdForm::Text),
            Some(other) => {
                let detail = "is neither \"number\" nor \"text\"";
                Err(Fault::in_parameter("ids", detail, other).into())
            }
        }
    }

    /// How much is to be answered.
    pub(super) fn returned(&self) -> Result<Return, Problem> {
        match self.text("return") {
            None | Some("representation") => Ok(Return::Representation),
            Some("minimal") => Ok(Return::Minimal),
            Some(other) => Err(Fault::in_parameter(
                "return",
                "is neither \"minimal\" nor \"representation\"",
                other,
            )
            .into()),
        }
    }
}

/// How much is answered to a change.
#[derive(Clone, Copy, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "lowercase")]
pub(in crate::wire) enum Return {
    /// What it did.
    Minimal,
    /// Also the totals after it.
    Representation,
}

/// A number in a parameter.
pub(super) fn whole(name: &'static str, text: &str) -> Result<u64, Problem> {
    // `parse` alone would take a plus sign.
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    match text.parse() {
        Ok(number) if digits => Ok(number),
        _ => Err(Fault::in_parameter(
            name,
            "is not a whole number from 0 to 18446744073709551615",
            text,
        )
        .into()),
    }
}

/// Types of bodies.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum BodyType {
    Json,
    Ndjson,
    Protobuf,
    Csv,
    Html,
}

impl BodyType {
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Ndjson => "application/x-ndjson",
            Self::Protobuf => "application/x-protobuf",
            Self::Csv => "text/csv",
            Self::Html => "text/html",
        }
    }

    fn media_type(self) -> MediaType<'static> {
        MediaType::parse(self.name()).expect("these are names of types")
    }

    /// The `Content-Type` of an answer.
    pub(super) fn value(self) -> HeaderValue {
        HeaderValue::from_static(match self {
            Self::Csv => "text/csv; charset=utf-8",
            Self::Html => "text/html; charset=utf-8",
            other => other.name(),
        })
    }
}

/// The type of a request's body, one of `taken`.
pub(super) fn body_type(headers: &HeaderMap, taken: &[BodyType]) -> Result<BodyType, Problem> {
    let refuse = |what: Cow<'static, str>| {
        let names: Vec<_> = taken.iter().map(|one| one.name()).collect();
        let detail = format!("{what}; taken here: {}", names.join(", "));
        Problem::new(Code::UnsupportedMediaType, detail)
    };
    if let Some(coding) = headers.get(header::CONTENT_ENCODING)
        && !coding.as_bytes().eq_ignore_ascii_case(b"identity")
    {
        return Err(refuse(
            format!("Content-Encoding {coding:?} is not taken").into(),
        ));
    }
    let Some(given) = headers.get(header::CONTENT_TYPE) else {
        return Err(refuse("there is no Content-Type".into()));
    };
    let text = given.to_str().unwrap_or_default();
    let found = MediaType::parse(text).ok().and_then(|given| {
        let is_given = |one: &&BodyType| one.media_type() == given.essence();
        taken.iter().find(is_given)
    });
    found
        .copied()
        .ok_or_else(|| refuse(format!("Content-Type is {given:?}").into()))
}

/// Which of the types that can be answered the client prefers; the first when it does not say, or takes none of them.
pub(super) fn preferred(headers: &HeaderMap, offered: &[BodyType]) -> BodyType {
    let accept: Option<Accept> = headers.typed_get();
    let types: Vec<_> = offered.iter().map(|one| one.media_type()).collect();
    let found = accept.as_ref().and_then(|accept| accept.negotiate(&types));
    let chosen = found.and_then(|found| offered.iter().find(|one| one.media_type() == *found));
    chosen.copied().unwrap_or(offered[0])
}

/// What is said of an answer whose type depends on the request.
pub(super) const VARY: [(header::HeaderName, HeaderValue); 1] =
    [(header::VARY, HeaderValue::from_static("accept"))];

/// The header `Idempotency-Key`, if there is one.
pub(super) fn idempotency_key(headers: &HeaderMap) -> Result<Option<Box<str>>, Problem> {
    const NAME: &str = "Idempotency-Key";
    let mut values = headers.get_all(NAME).iter();
    let Some(value) = values.next() else {
        return Ok(None);
    };
    if values.next().is_some() {
        let sent = String::from_utf8_lossy(value.as_bytes());
        return Err(Fault::in_parameter(NAME, "stands twice", &sent).into());
    }
    calls::idempotency_key(value.as_bytes()).map(Some)
}

/// The memory that a request's body takes.
pub(super) struct Room(Share);

impl Room {
    /// Takes so many bytes more, for what an answer is made of.
    pub(super) fn take(&mut self, bytes: u64) -> Result<(), Problem> {
        if self.0.take(bytes) {
            Ok(())
        } else {
            Err(room::share_used())
        }
    }
}

impl FromRequestParts<App> for Room {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Infallible> {
        let client = room::client(&parts.extensions);
        Ok(Self(app.service.budget().share(client)))
    }
}

/// A body that was read whole, and the room that it takes as long as it is there.
pub(super) struct Whole {
    pub(super) bytes: Bytes,
    _share: Share,
}

/// Reads a body whole. Of each byte that arrives as much memory is taken as what it becomes.
pub(super) async fn read(
    headers: &HeaderMap,
    body: Body,
    limits: &Limits,
    Room(mut share): Room,
) -> Result<Whole, Problem> {
    // What a client announces is believed only so far: memory follows what arrives.
    const RESERVED_BYTES_MAX: usize = 1 << 20;
    let is_message = body_type(headers, &[BodyType::Protobuf]).is_ok();
    let weight = if is_message {
        room::MESSAGE_WEIGHT
    } else {
        room::JSON_WEIGHT
    };
    let share_max = share.budget().share_max() / weight;
    let too_large = |bytes: usize| {
        if bytes <= limits.body_bytes_max {
            return room::too_large(share_max);
        }
        let detail = format!("the body is larger than {} bytes", limits.body_bytes_max);
        Problem::new(Code::TooLarge, detail)
    };
    let bytes_max = usize::try_from(share_max).unwrap_or(usize::MAX);
    let bytes_max = bytes_max.min(limits.body_bytes_max);
    let announced: Option<usize> = headers
        .get(header::CONTENT_LENGTH)
        .and_then(|length| length.to_str().ok()?.parse().ok());
    let most = announced.unwrap_or(bytes_max);
    if most > bytes_max {
        return Err(too_large(most));
    }
    let reading = async {
        let mut read = Vec::with_capacity(most.min(RESERVED_BYTES_MAX));
        let mut body = body.into_data_stream();
        while let Some(piece) = body.next().await {
            let piece = piece.map_err(|error| broken(&error))?;
            if piece.len() > bytes_max - read.len() {
                return Err(too_large(read.len() + piece.len()));
            }
            if !share.take(room::weighed(piece.len(), weight)) {
                return Err(room::share_used());
            }
            read.extend_from_slice(&piece);
        }
        Ok(Whole {
            bytes: read.into(),
            _share: share,
        })
    };
    match tokio::time::timeout(limits.request_timeout, reading).await {
        Ok(read) => read,
        Err(_) => Err(slow_request(limits.request_timeout)),
    }
}

/// The connection broke while the body arrived.
pub(super) fn broken(error: &axum::Error) -> Problem {
    Problem::new(Code::BadRequest, format!("the body broke off: {error}"))
}

/// The body did not arrive.
pub(super) fn slow_request(waited: Duration) -> Problem {
    let detail = format!("the server waited {} s for the body", waited.as_secs_f64());
    Problem::new(Code::RequestTimeout, detail)
}
