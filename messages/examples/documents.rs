//! Writes `docs/schemas/*.json` and `docs/asyncapi.json` from the types.
//!
//! `cargo run -p verge-messages --features schema --example documents`

use verge_messages::asyncapi::{documents, text};

fn main() -> std::io::Result<()> {
    for (path, document) in documents() {
        let path = format!("{}/../docs/{path}", env!("CARGO_MANIFEST_DIR"));
        std::fs::write(&path, text(&document))?;
        println!("{path}");
    }
    Ok(())
}
