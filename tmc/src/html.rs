//! Pages: one frame and one style for all of them. No script, nothing fetched.

/// The style of every page.
pub const STYLE: &str = include_str!("style.css");

/// Text for HTML, in content and in quoted attributes.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace('\'', "&#39;")
}

/// A page with a title and a body; it is read again after so many seconds, if that is given.
pub fn page(title: &str, body: &str, again_s: Option<u32>) -> Vec<u8> {
    let title = escaped(title);
    let again = again_s.map_or_else(String::new, |seconds| {
        format!("<meta http-equiv=\"refresh\" content=\"{seconds}\">\n")
    });
    // An icon that is empty is not asked for.
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n{again}\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <link rel=\"icon\" href=\"data:,\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n\
         <a class=\"skip\" href=\"#main\">To the content</a>\n<main id=\"main\" tabindex=\"-1\">\n\
         <h1>{title}</h1>\n{body}</main>\n</body>\n</html>\n"
    )
    .into_bytes()
}
