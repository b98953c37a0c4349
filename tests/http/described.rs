//! Holds every answer of these tests against the description of the API.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use jsonschema::Validator;
use reqwest::{Client, Method, Url};
use serde_json::Value;
use tokio::sync::OnceCell;

use crate::server::Answer;

/// The description, the same of every server in this process, and what was compiled of it.
struct Description {
    document: Value,
    validators: Mutex<HashMap<String, Arc<Validator>>>,
}

static DESCRIPTION: OnceCell<Description> = OnceCell::const_new();

/// Checks that the description has the answer's status and type, and that its body is what the schema says.
pub(crate) async fn check(client: &Client, method: &Method, url: &Url, answer: &Answer) {
    let description = DESCRIPTION.get_or_init(|| read(client, url)).await;
    let called = format!("{method} {url} answers {}", answer.status);
    let kind = answer.header("content-type").split(';').next().unwrap();
    let schema = match operation(&description.document, method, url.path()) {
        Some((name, operation)) => {
            let response = &operation["responses"][answer.status.to_string()];
            assert!(response.is_object(), "{called}, which is not described");
            if answer.text.is_empty() {
                return;
            }
            let content = response["content"].as_object();
            let content = content.unwrap_or_else(|| panic!("{called} with a body"));
            let mut kinds = content.iter();
            let named = kinds.find(|(name, _)| name.split(';').next() == Some(kind));
            let (_, content) = named.unwrap_or_else(|| panic!("{called} with {kind}"));
            (
                format!("{name} {} {kind}", answer.status),
                &content["schema"],
            )
        }
        // What belongs to no call is a problem, too.
        None if kind == "application/problem+json" => {
            let schema = &description.document["components"]["schemas"]["Problem"];
            ("problem".to_owned(), schema)
        }
        None => return,
    };
    let validator = description.validator(schema);
    let validate = |text: &str| {
        let value = serde_json::from_str(text).unwrap();
        let faults: Vec<_> = validator
            .iter_errors(&value)
            .map(|fault| format!("{}: {fault}", fault.instance_path()))
            .collect();
        assert!(faults.is_empty(), "{called}: {text}: {faults:?}");
    };
    match kind {
        "application/json" | "application/problem+json" => validate(&answer.text),
        "application/x-ndjson" => answer.text.lines().take(100).for_each(validate),
        _ => {}
    }
}

async fn read(client: &Client, url: &Url) -> Description {
    let description = url.join("/openapi.json").unwrap();
    let answer = client.get(description).send().await.unwrap();
    Description {
        document: serde_json::from_str(&answer.text().await.unwrap()).unwrap(),
        validators: Mutex::default(),
    }
}

/// The operation of a call, with its name.
fn operation<'a>(document: &'a Value, method: &Method, path: &str) -> Option<(String, &'a Value)> {
    let fits = |template: &str| {
        let (mut steps, mut parts) = (path.split('/'), template.split('/'));
        loop {
            match (steps.next(), parts.next()) {
                (None, None) => return true,
                (Some(step), Some(part)) if step == part || part.starts_with('{') => {}
                _ => return false,
            }
        }
    };
    let paths = document["paths"].as_object()?;
    let (template, item) = paths.iter().find(|(template, _)| fits(template))?;
    let operation = item.get(method.as_str().to_lowercase())?;
    Some((format!("{method} {template}"), operation))
}

impl Description {
    fn validator(&self, (name, schema): (String, &Value)) -> Arc<Validator> {
        let mut validators = self.validators.lock().unwrap();
        let compile = || {
            let mut schema = schema.clone();
            schema["components"] = self.document["components"].clone();
            Arc::new(jsonschema::draft202012::new(&schema).unwrap())
        };
        validators.entry(name).or_insert_with(compile).clone()
    }
}
