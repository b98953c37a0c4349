//! The shapes of JSON that are read as well as written, each once: what serde reads and writes, what the description of the API
//! says, and what faults are found by.

use std::fmt;

use serde::de::{Deserializer, Error, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use utoipa::openapi::schema::{ObjectBuilder, OneOfBuilder, Schema};
use utoipa::openapi::{RefOr, Type};
use utoipa::{PartialSchema, ToSchema};

use crate::geometry::{CubeId, Place};
use crate::wire::convert::Settings;
use crate::wire::objects::{not_null, objects_only, written};

/// How ids are written.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, ToSchema)]
#[schema(rename_all = "lowercase")]
pub enum IdForm {
    /// As numbers.
    #[default]
    Number,
    /// As decimal strings.
    Text,
}

/// A cube's id: the client's own whole number from 0 to 2^64 - 1, or its decimal string.
///
/// Both are read everywhere. JavaScript and others keep numbers as floats and lose ids above 2^53: they send strings, and are answered
/// with strings when they ask with `?ids=text`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Id {
    /// The id.
    pub id: CubeId,
    /// How it is written.
    pub form: IdForm,
}

/// What an id is not, when it is none.
pub(super) const NO_WHOLE_NUMBER: &str = "is not a whole number from 0 to 18446744073709551615";

/// The id that a decimal string is. As in a JSON number there is no sign and no zero in front: an id has one text.
pub(super) fn decimal(text: &str) -> Option<u64> {
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    let canonical = digits && (text == "0" || !text.starts_with('0'));
    canonical.then(|| text.parse().ok()).flatten()
}

impl Serialize for Id {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.form {
            IdForm::Number => serializer.serialize_u64(self.id.0),
            IdForm::Text => serializer.collect_str(&self.id.0),
        }
    }
}

impl<'de> Deserialize<'de> for Id {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl Visitor<'_> for Read {
            type Value = Id;
            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a whole number or its decimal string")
            }
            fn visit_u64<E: Error>(self, id: u64) -> Result<Id, E> {
                Ok(Id {
                    id: CubeId(id),
                    form: IdForm::Number,
                })
            }
            fn visit_str<E: Error>(self, text: &str) -> Result<Id, E> {
                let id = decimal(text).ok_or_else(|| E::custom(NO_WHOLE_NUMBER))?;
                Ok(Id {
                    id: CubeId(id),
                    form: IdForm::Text,
                })
            }
        }
        deserializer.deserialize_any(Read)
    }
}

impl PartialSchema for Id {
    fn schema() -> RefOr<Schema> {
        let number = ObjectBuilder::new()
            .schema_type(Type::Integer)
            .minimum(Some(0))
            .maximum(Some(usize::MAX));
        let text = ObjectBuilder::new()
            .schema_type(Type::String)
            .max_length(Some(20))
            .pattern(Some("^(0|[1-9][0-9]*)$"));
        OneOfBuilder::new()
            .item(number)
            .item(text)
            .description(Some(
                "A cube's id: the client's own whole number from 0 to 2^64 - 1, or its decimal string. Both are read everywhere. Numbers \
                 above 2^53 do not survive JavaScript and others that keep them as floats: send strings then, and ask with `?ids=text` to be \
                 answered with strings.",
            ))
            .examples([serde_json::json!(18)])
            .into()
    }
}

impl ToSchema for Id {}

/// A cube.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct Cube {
    /// Its id, unique in the scene.
    pub id: Id,
    /// Where it is: its lower corner or its centre, as the scene's anchor says. Units: user units. `[x, y, z]`
    #[schema(min_items = 3, max_items = 3, example = json!([0.0, 0.0, 2.5]))]
    pub at: [f64; 3],
}

impl Cube {
    /// A cube of a scene, as it is answered.
    pub fn new((id, place): (CubeId, Place), form: IdForm, settings: &Settings) -> Self {
        Self {
            id: Id { id, form },
            at: settings.at(place),
        }
    }
}

/// A cube to insert, whose id may be left out.
#[derive(Clone, Copy, PartialEq, Debug, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct NewCube {
    /// Its id, unique in the scene. All cubes of a change have one, or none has: then the server numbers them.
    #[serde(default, deserialize_with = "not_null")]
    #[schema(nullable = false)]
    pub id: Option<Id>,
    /// Where it is: its lower corner or its centre, as the scene's anchor says. Units: user units. `[x, y, z]`
    #[schema(min_items = 3, max_items = 3, example = json!([0.0, 0.0, 2.5]))]
    pub at: [f64; 3],
}

/// An atomic change: deletions first, then insertions; all of it, or nothing.
#[derive(Clone, PartialEq, Debug, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct Change {
    /// Ids of the cubes to delete.
    #[serde(default)]
    pub delete: Vec<Id>,
    /// Cubes to insert.
    #[serde(default)]
    pub insert: Vec<NewCube>,
    /// The sender's own number of the move or program line that the change belongs to.
    #[serde(default, deserialize_with = "not_null")]
    #[schema(nullable = false, example = 120)]
    pub r#move: Option<u64>,
    /// Machine time of the change. Units: seconds.
    #[serde(default, deserialize_with = "not_null")]
    #[schema(nullable = false, minimum = 0, maximum = 1_000_000_000, example = 0.25)]
    pub duration: Option<f64>,
}

// `C` is a `Cube`, or in files, where ids may be left out, a `NewCube`.
/// One line of a stream: one operation.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize, ToSchema)]
#[serde(
    rename_all = "lowercase",
    expecting = "neither {\"insert\":{\"id\":..,\"at\":[..]}} nor {\"delete\":..}"
)]
pub enum LineOperation<C> {
    /// Insert a cube.
    Insert(C),
    /// Delete the cube of this id.
    Delete(Id),
}

/// Where to go back to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct Revert {
    /// The seq whose cubes are wanted again.
    pub to: u64,
}

/// What an audit is asked with: nothing.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct AuditRequest {}

objects_only!(Cube, NewCube, Change, Revert, AuditRequest);
written!(Cube);
