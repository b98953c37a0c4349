//! What serde is told about the objects of JSON documents: no lists in place of objects, no null in place of what is left out.

use std::fmt;

use serde::de::{Deserializer, MapAccess, Visitor};
use serde::{Deserialize, forward_to_deserialize_any};

/// Reads these structs, whose derived functions are their own (`remote = "Self"`), from objects alone.
macro_rules! objects_only {
    ($($document:ident),*) => {$(
        impl<'de> Deserialize<'de> for $document {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                $document::deserialize($crate::wire::objects::ObjectOnly(deserializer))
            }
        }
    )*};
}

/// Writes these structs by their derived functions (`remote = "Self"` makes them their own).
macro_rules! written {
    ($($document:ident),*) => {$(
        impl Serialize for $document {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                $document::serialize(self, serializer)
            }
        }
    )*};
}

pub(super) use {objects_only, written};

/// The name of a struct that may be a list of three numbers, too, for those who read JSON in a way of their own.
pub(super) const LIST_OR_OBJECT: &str = "list or object";

/// The name of a struct whose members are a choice of one and [`TOP`] beside it, for the same.
pub(super) const CHOICE_AND_TOP: &str = "choice and top";

/// The member that may stand beside the one chosen.
pub(super) const TOP: &str = "top";

/// Reads a struct from an object alone. Left to itself serde takes the list of its members' values for one, too.
pub(super) struct ObjectOnly<T>(pub(super) T);

impl<'de, D: Deserializer<'de>> Deserializer<'de> for ObjectOnly<D> {
    type Error = D::Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, D::Error> {
        self.0.deserialize_struct(name, fields, ObjectOnly(visitor))
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, D::Error> {
        self.0.deserialize_any(ObjectOnly(visitor))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map enum identifier ignored_any
    }
}

impl<'de, V: Visitor<'de>> Visitor<'de> for ObjectOnly<V> {
    type Value = V::Value;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.expecting(formatter)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<V::Value, A::Error> {
        self.0.visit_map(map)
    }
}

/// Reads a member that may be left out, but is not null.
pub(super) fn not_null<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}
