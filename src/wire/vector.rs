//! Vectors in the description of the API.

use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ArrayBuilder, Schema};
use utoipa::{PartialSchema, ToSchema};

/// Three numbers, one an axis: what a list of lists consists of (`value_type`). A list that is not within another says how long it
/// is by itself, with `min_items` and `max_items`.
pub(super) struct Vector;

impl PartialSchema for Vector {
    fn schema() -> RefOr<Schema> {
        ArrayBuilder::new()
            .items(f64::schema())
            .min_items(Some(3))
            .max_items(Some(3))
            .into()
    }
}

impl ToSchema for Vector {}
