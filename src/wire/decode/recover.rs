//! Reads JSON on after a fault, so that all faults of a body are found at once.
//!
//! It is led by the same `Deserialize` that reads good bodies: a value that cannot be read is noted, with its place, and a stand-in
//! (0, an empty text or list) takes its place in the document. So there is no second description of any shape.
//!
//! ```text
//!   raw JSON ── Recovering ── visitors of the document's own types ── document with stand-ins
//!                   └──────── unreadable, unknown, repeated, missing ── Faults
//! ```

use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fmt;

use serde::de::value::StrDeserializer;
use serde::de::{
    Deserialize, DeserializeSeed, Deserializer, EnumAccess, Error, IntoDeserializer, MapAccess,
    SeqAccess, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use serde_json::value::RawValue;

use crate::wire::documents::{NO_WHOLE_NUMBER, decimal};
use crate::wire::objects::{CHOICE_AND_TOP, LIST_OR_OBJECT, TOP};
use crate::wire::problem::{Fault, Faults};

/// Reads a document with stand-ins for what is at fault; none when its types themselves refuse a value that has no fault of these kinds.
///
/// Reading ends when there are as many faults as are named, and of a list at its `elements_max`-th element.
pub(super) fn read<'de, T: Deserialize<'de>>(
    raw: &'de RawValue,
    elements_max: usize,
) -> (Option<T>, Faults) {
    let mut notes = Notes {
        faults: RefCell::default(),
        required: RefCell::default(),
        elements_max,
    };
    loop {
        let reader = Recovering {
            raw: Some(raw),
            at: &Pointer::Body,
            notes: &notes,
        };
        let read = T::deserialize(reader);
        match read {
            // A type tells that a member is required only when it is missing, and then it is too late for a stand-in.
            Err(Interrupted::Learned) => notes.faults = RefCell::default(),
            Ok(document) => return (Some(document), notes.faults.into_inner()),
            Err(interrupted) => {
                let mut faults = notes.faults.into_inner();
                let detail = format!("is refused: {interrupted}");
                faults.push(Fault::at(String::new(), detail, Some(raw)));
                return (None, faults);
            }
        }
    }
}

/// Shows beside each fault that has no value yet what was sent at its place.
pub(super) fn show_values(body: &RawValue, faults: &mut Faults) {
    let wanted = faults
        .as_mut_slice()
        .iter_mut()
        .filter(|fault| fault.value.is_none());
    let wanted = wanted.filter_map(|fault| Some((fault.pointer.clone()?, fault)));
    show(body, wanted.collect());
}

/// `wanted`: faults at or below `raw`, each with the rest of its pointer.
fn show(raw: &RawValue, wanted: Vec<(String, &mut Fault)>) {
    let mut below: Vec<(String, Vec<(String, &mut Fault)>)> = Vec::new();
    for (pointer, fault) in wanted {
        let Some(steps) = pointer.strip_prefix('/') else {
            fault.show(raw);
            continue;
        };
        let end = steps.find('/').unwrap_or(steps.len());
        let (step, rest) = (steps[..end].to_owned(), steps[end..].to_owned());
        match below.iter_mut().find(|(known, _)| *known == step) {
            Some((_, faults)) => faults.push((rest, fault)),
            None => below.push((step, vec![(rest, fault)])),
        }
    }
    let mut visit = |step: &str, raw: &RawValue| {
        if let Some(found) = below.iter().position(|(known, _)| known == step) {
            show(raw, below.swap_remove(found).1);
        }
        !below.is_empty()
    };
    match raw.get().as_bytes()[0] {
        b'{' => drop(each_member(raw, |name, raw| {
            visit(&escaped(&name), raw);
        })),
        b'[' => {
            each_element(raw, |index, raw| visit(&index.to_string(), raw));
        }
        _ => {}
    }
}

/// Elements of the only lists that have a fixed length.
const COORDINATES: usize = 3;

/// What is found while reading.
struct Notes {
    faults: RefCell<Faults>,
    /// Members that turned out to be required: name of the type, name of the member.
    required: RefCell<BTreeSet<(&'static str, &'static str)>>,
    elements_max: usize,
}

/// A place in the body.
enum Pointer<'a> {
    Body,
    Member(&'a Pointer<'a>, &'a str),
    Element(&'a Pointer<'a>, usize),
}

impl fmt::Display for Pointer<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Body => Ok(()),
            Self::Member(of, name) => write!(formatter, "{of}/{}", escaped(name)),
            Self::Element(of, index) => write!(formatter, "{of}/{index}"),
        }
    }
}

/// A member's name as a step of an RFC 6901 pointer.
fn escaped(name: &str) -> String {
    name.replace('~', "~0").replace('/', "~1")
}

/// Why reading ended early.
#[derive(Debug)]
enum Interrupted {
    /// A required member is missing; the types say no more.
    Missing(&'static str),
    /// A required member has been learned: reading begins again.
    Learned,
    /// A type refuses a value for reasons of its own.
    Refused(String),
}

impl fmt::Display for Interrupted {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing(name) => write!(formatter, "{name} is missing"),
            Self::Learned => formatter.write_str("a member is missing"),
            Self::Refused(why) => formatter.write_str(why),
        }
    }
}

impl std::error::Error for Interrupted {}

impl Error for Interrupted {
    fn custom<T: fmt::Display>(why: T) -> Self {
        Self::Refused(why.to_string())
    }

    fn missing_field(name: &'static str) -> Self {
        Self::Missing(name)
    }
}

/// Gives a value to a visitor, or notes what is wrong with it and gives a stand-in.
#[derive(Clone, Copy)]
struct Recovering<'a, 'de> {
    /// None where nothing was sent, or what was sent is at fault already: then stand-ins are given and nothing is noted.
    raw: Option<&'de RawValue>,
    at: &'a Pointer<'a>,
    notes: &'a Notes,
}

impl<'de> Recovering<'_, 'de> {
    fn note(&self, detail: impl Into<Cow<'static, str>>) {
        let fault = Fault::at(self.at.to_string(), detail, self.raw);
        self.notes.faults.borrow_mut().push(fault);
    }

    /// What `read` makes of the value; none, and noted, when it cannot be read.
    fn value<T>(&self, read: impl FnOnce(&'de RawValue) -> Result<T, &'static str>) -> Option<T> {
        match read(self.raw?) {
            Ok(value) => Some(value),
            Err(detail) => {
                self.note(detail);
                None
            }
        }
    }

    /// The known members, each once; the others are noted. None, and noted, when the value is no object.
    fn members(&self, known: &'static [&'static str]) -> Option<Vec<Member<'de>>> {
        let mut members: Vec<Member<'de>> = Vec::new();
        let read = each_member(self.raw?, |name, raw| {
            let at = Pointer::Member(self.at, &name);
            let member = Recovering {
                raw: Some(raw),
                at: &at,
                notes: self.notes,
            };
            let Some(&name) = known.iter().find(|known| **known == name) else {
                member.note(match known {
                    [] => "is not known here; there are no members".to_owned(),
                    known => format!("is not known here; known are {}", known.join(", ")),
                });
                return;
            };
            if members.iter().any(|(earlier, _)| *earlier == name) {
                member.note("stands twice");
            } else {
                members.push((name, Some(raw)));
            }
        });
        if read.is_err() {
            self.note("is not an object");
            return None;
        }
        Some(members)
    }

    /// The elements of a list, as many as are read; none, and noted, when the value is no list.
    fn elements(&self, detail: &'static str) -> Option<Vec<&'de RawValue>> {
        let mut elements = Vec::new();
        let is_list = each_element(self.raw?, |_, raw| {
            elements.push(raw);
            elements.len() < self.notes.elements_max.max(COORDINATES + 1)
        });
        if !is_list {
            self.note(detail);
        }
        is_list.then_some(elements)
    }
}

type Member<'de> = (&'static str, Option<&'de RawValue>);

/// The same of an object whose members have names of the client's own.
type NamedMember<'de> = (Cow<'static, str>, Option<&'de RawValue>);

impl<'de> Deserializer<'de> for Recovering<'_, 'de> {
    type Error = Interrupted;

    /// Only ids have no type of their own in JSON: a whole number or its decimal string.
    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        let id = self.value(|raw| {
            let text = serde_json::from_str::<String>(raw.get()).ok();
            let id = decimal(text.as_deref().unwrap_or(raw.get()));
            id.ok_or(NO_WHOLE_NUMBER)
        });
        visitor.visit_u64(id.unwrap_or_default())
    }

    /// What is read elsewhere.
    fn deserialize_ignored_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        visitor.visit_unit()
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        let whole = self.value(|raw| decimal(raw.get()).ok_or(NO_WHOLE_NUMBER));
        visitor.visit_u64(whole.unwrap_or_default())
    }

    fn deserialize_u16<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        let whole = self.value(|raw| {
            let small = decimal(raw.get()).and_then(|number| u16::try_from(number).ok());
            small.ok_or("is not a whole number from 0 to 65535")
        });
        visitor.visit_u16(whole.unwrap_or_default())
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        visitor.visit_f64(self.value(number).unwrap_or_default())
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        let text = self.value(|raw| serde_json::from_str(raw.get()).map_err(|_| "is not a string"));
        visitor.visit_string(text.unwrap_or_default())
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        self.deserialize_string(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        match self.raw {
            Some(_) => visitor.visit_some(self),
            None => visitor.visit_none(),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, Interrupted> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        let elements = self.elements("is not a list").unwrap_or_default();
        visitor.visit_seq(Elements {
            of: self,
            sent: elements.into_iter(),
            index: 0,
            stand_ins: 0,
        })
    }

    /// An object whose members have names of the client's own.
    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Interrupted> {
        let mut members: Vec<NamedMember<'de>> = Vec::new();
        let read = self.raw.map(|raw| {
            each_member(raw, |name, raw| {
                if members.iter().any(|(earlier, _)| *earlier == name) {
                    let at = Pointer::Member(self.at, &name);
                    let member = Recovering {
                        raw: Some(raw),
                        at: &at,
                        notes: self.notes,
                    };
                    member.note("stands twice");
                } else {
                    members.push((name.into(), Some(raw)));
                }
            })
        });
        if let Some(Err(_)) = read {
            self.note("is not an object");
        }
        visitor.visit_map(Members {
            of: self,
            sent: members.into_iter(),
            next: None,
        })
    }

    /// A list of so many numbers: there are no other lists of a fixed length in the API.
    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, Interrupted> {
        const DETAIL: &str = "is not a list of three numbers";
        let elements = self.elements(DETAIL);
        let count = elements.as_ref().map_or(len, Vec::len);
        let mut elements = elements.unwrap_or_default();
        elements.truncate(len);
        let read = visitor.visit_seq(Elements {
            of: self,
            stand_ins: len - elements.len(),
            sent: elements.into_iter(),
            index: 0,
        });
        if count != len {
            self.note(DETAIL);
        }
        read
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Interrupted> {
        let is_list = |raw: &RawValue| raw.get().starts_with('[');
        if name == LIST_OR_OBJECT && self.raw.is_some_and(is_list) {
            return self.deserialize_tuple(COORDINATES, visitor);
        }
        let before = self.notes.faults.borrow().len();
        let sent = self.members(fields);
        let is_object = sent.is_some();
        let mut members = sent.unwrap_or_default();
        if name == CHOICE_AND_TOP && members.iter().filter(|(name, _)| *name != TOP).count() != 1 {
            if is_object && self.notes.faults.borrow().len() == before {
                self.note(choice(&visitor, &fields[..fields.len() - 1]));
            }
            members = vec![(fields[0], None)];
        }
        for (of, field) in self.notes.required.borrow().iter() {
            if *of != name || members.iter().any(|(there, _)| there == field) {
                continue;
            }
            if is_object {
                let pointer = Pointer::Member(self.at, field).to_string();
                let fault = Fault::at(pointer, "is missing", None);
                self.notes.faults.borrow_mut().push(fault);
            }
            members.push((field, None));
        }
        let named = members.into_iter().map(|(name, raw)| (name.into(), raw));
        let read = visitor.visit_map(Members {
            of: self,
            sent: named.collect::<Vec<NamedMember<'de>>>().into_iter(),
            next: None,
        });
        match read {
            Err(Interrupted::Missing(field)) => {
                let new = self.notes.required.borrow_mut().insert((name, field));
                assert!(new, "a stand-in was given for {name}.{field}");
                Err(Interrupted::Learned)
            }
            read => read,
        }
    }

    /// A choice of names (a text), or of operations (an object with one member).
    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Interrupted> {
        let stand_in = (variants[0], None);
        let mut is_bare = false;
        let chosen = match self.raw {
            None => stand_in,
            Some(raw) if raw.get().starts_with('{') => {
                let before = self.notes.faults.borrow().len();
                let members = self.members(variants).unwrap_or_default();
                let clean = self.notes.faults.borrow().len() == before;
                if let [chosen] = members[..] {
                    chosen
                } else {
                    if clean {
                        self.note(choice(&visitor, variants));
                    }
                    stand_in
                }
            }
            Some(raw) => {
                let text: Option<String> = serde_json::from_str(raw.get()).ok();
                let known = variants.iter().find(|name| text.as_deref() == Some(**name));
                if let Some(name) = known {
                    is_bare = true;
                    (*name, None)
                } else {
                    self.note(choice(&visitor, variants));
                    stand_in
                }
            }
        };
        visitor.visit_enum(Chosen {
            of: self,
            member: chosen,
            is_bare,
        })
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u32 u128 f32 char bytes byte_buf unit unit_struct tuple_struct identifier
    }
}

/// What a choice is not: in the words of its type where it has its own, else by its names.
fn choice<'de>(visitor: &impl Visitor<'de>, variants: &[&str]) -> String {
    struct Expected<'a, V>(&'a V);
    impl<'de, V: Visitor<'de>> fmt::Display for Expected<'_, V> {
        fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            self.0.expecting(formatter)
        }
    }
    let own = Expected(visitor).to_string();
    if own.starts_with("neither ") {
        return format!("is {own}");
    }
    let names: Vec<_> = variants.iter().map(|name| format!("{name:?}")).collect();
    format!("is neither {}", names.join(" nor "))
}

/// The elements of a list, then stand-ins.
struct Elements<'a, 'de> {
    of: Recovering<'a, 'de>,
    sent: std::vec::IntoIter<&'de RawValue>,
    index: usize,
    stand_ins: usize,
}

impl<'de> SeqAccess<'de> for Elements<'_, 'de> {
    type Error = Interrupted;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Interrupted> {
        let enough = self.of.notes.faults.borrow().is_full() && self.stand_ins == 0;
        let raw = self.sent.next().filter(|_| !enough);
        if raw.is_none() {
            let Some(left) = self.stand_ins.checked_sub(1) else {
                return Ok(None);
            };
            self.stand_ins = left;
        }
        let at = Pointer::Element(self.of.at, self.index);
        self.index += 1;
        let element = Recovering {
            raw,
            at: &at,
            notes: self.of.notes,
        };
        seed.deserialize(element).map(Some)
    }
}

/// The members of an object.
struct Members<'a, 'de> {
    of: Recovering<'a, 'de>,
    sent: std::vec::IntoIter<NamedMember<'de>>,
    next: Option<NamedMember<'de>>,
}

impl<'de> MapAccess<'de> for Members<'_, 'de> {
    type Error = Interrupted;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Interrupted> {
        self.next = self.sent.next();
        let Some((name, _)) = &self.next else {
            return Ok(None);
        };
        let name: StrDeserializer<'_, Interrupted> = (&**name).into_deserializer();
        seed.deserialize(name).map(Some)
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(
        &mut self,
        seed: V,
    ) -> Result<V::Value, Interrupted> {
        let (name, raw) = self
            .next
            .take()
            .expect("a name was asked for before its value");
        let at = Pointer::Member(self.of.at, &name);
        seed.deserialize(Recovering {
            raw,
            at: &at,
            notes: self.of.notes,
        })
    }
}

/// A variant and its value.
struct Chosen<'a, 'de> {
    of: Recovering<'a, 'de>,
    member: Member<'de>,
    /// Whether its name was sent alone: right for a name, and at fault for what has a value.
    is_bare: bool,
}

impl<'de> EnumAccess<'de> for Chosen<'_, 'de> {
    type Error = Interrupted;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'de>>(
        self,
        seed: V,
    ) -> Result<(V::Value, Self), Interrupted> {
        let name: StrDeserializer<'_, Interrupted> = self.member.0.into_deserializer();
        Ok((seed.deserialize(name)?, self))
    }
}

impl<'de> VariantAccess<'de> for Chosen<'_, 'de> {
    type Error = Interrupted;

    fn unit_variant(self) -> Result<(), Interrupted> {
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(
        self,
        seed: T,
    ) -> Result<T::Value, Interrupted> {
        let (name, raw) = self.member;
        if self.is_bare {
            self.of
                .note(format!("is no object with the member {name:?}"));
        }
        let at = Pointer::Member(self.of.at, name);
        seed.deserialize(Recovering {
            raw,
            at: &at,
            notes: self.of.notes,
        })
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, _: V) -> Result<V::Value, Interrupted> {
        Err(Interrupted::custom("the API has no variants of this kind"))
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Interrupted> {
        Err(Interrupted::custom("the API has no variants of this kind"))
    }
}

/// A finite number.
fn number(raw: &RawValue) -> Result<f64, &'static str> {
    match raw.get() {
        "\"NaN\"" | "\"Infinity\"" | "\"-Infinity\"" => Err("is not a finite number"),
        text if text.starts_with(|first: char| first == '-' || first.is_ascii_digit()) => text
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite())
            .ok_or("is not a finite number"),
        _ => Err("is not a number"),
    }
}

/// Shows the members of an object to `visit`, as they stand; an error when the value is no object.
fn each_member<'de>(
    raw: &'de RawValue,
    visit: impl FnMut(String, &'de RawValue),
) -> Result<(), serde_json::Error> {
    struct Each<F>(F);
    impl<'de, F: FnMut(String, &'de RawValue)> Visitor<'de> for Each<F> {
        type Value = ();
        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str("an object")
        }
        fn visit_map<A: MapAccess<'de>>(mut self, mut map: A) -> Result<(), A::Error> {
            while let Some((name, raw)) = map.next_entry()? {
                self.0(name, raw);
            }
            Ok(())
        }
    }
    serde_json::Deserializer::from_str(raw.get()).deserialize_map(Each(visit))
}

/// Shows the elements of a list to `visit` until it answers false. False when the value is no list.
fn each_element<'de>(raw: &'de RawValue, visit: impl FnMut(usize, &'de RawValue) -> bool) -> bool {
    struct Each<F>(F);
    impl<'de, F: FnMut(usize, &'de RawValue) -> bool> Visitor<'de> for Each<F> {
        type Value = ();
        fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
            formatter.write_str("a list")
        }
        fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
            let mut index = 0;
            while let Some(raw) = list.next_element()? {
                if !(self.0)(index, raw) {
                    return Err(A::Error::custom("enough"));
                }
                index += 1;
            }
            Ok(())
        }
    }
    let is_list = raw.get().starts_with('[');
    if is_list {
        // The syntax was checked before, so an error is `visit`'s own.
        let _ = serde_json::Deserializer::from_str(raw.get()).deserialize_seq(Each(visit));
    }
    is_list
}
