//! Problems as the description of the API shows them. `wire::problem` writes them, and knows nothing of the settings and totals in some of
//! them.

use utoipa::ToSchema;

use super::scenes::AnySettings;
use crate::wire::documents::Id;
use crate::wire::kind::Properties;
use crate::wire::problem::Fault;

/// A problem document: RFC 9457 with the members of this API.
#[derive(ToSchema)]
#[schema(as = Problem)]
#[expect(
    dead_code,
    reason = "it stands in the description; problems are written by `wire::problem`"
)]
pub(super) struct ProblemDocument {
    /// URI of the type: `/problems/CODE` on this server, which explains it.
    #[schema(example = "/problems/invalid")]
    r#type: String,
    /// Summary of the type.
    title: String,
    /// HTTP status.
    status: u16,
    /// What is particular to this occurrence.
    detail: String,
    /// The first hundred faults of the request.
    #[schema(nullable = false)]
    errors: Option<Vec<Fault>>,
    /// Line of the body (or of the stream) where reading stopped, from 1.
    #[schema(nullable = false)]
    line: Option<u64>,
    /// Column in that line, from 1.
    #[schema(nullable = false)]
    column: Option<u64>,
    /// Lines from the stream's beginning that are committed.
    #[schema(nullable = false)]
    committed_lines: Option<u64>,
    /// The scene's seq after what was committed, null when the scene does not answer; of an audit, the seq it is as of.
    seq: Option<u64>,
    /// How far the replay is, 0 to 100.
    #[schema(nullable = false)]
    percent: Option<u8>,
    /// Why the scene does not answer.
    #[schema(nullable = false)]
    cause: Option<String>,
    /// The id in conflict.
    #[schema(nullable = false)]
    id: Option<Id>,
    /// Oldest seq that is kept.
    #[schema(nullable = false)]
    oldest: Option<u64>,
    /// Newest seq there is.
    #[schema(nullable = false)]
    newest: Option<u64>,
    /// The settings that the scene has.
    #[schema(nullable = false)]
    settings: Option<AnySettings>,
    /// The totals that the scene answers with.
    #[schema(nullable = false)]
    kept: Option<Properties>,
    /// The totals of its cubes or solids, recounted.
    #[schema(nullable = false)]
    recounted: Option<Properties>,
}
