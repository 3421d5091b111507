//! Addresses as people write them, and as they are shown.

use super::*;

#[test]
fn addresses_as_people_type_them() {
    for (text, shown, target) in [
        ("HTTP://Camera/x.jpg", "http://Camera/x.jpg", "/x.jpg"),
        (" http://camera:8080 ", "http://camera:8080/", "/"),
        ("http://camera?a=b c", "http://camera/?...", "/?a=b%20c"),
        ("http://camera:80/a%20b", "http://camera/a%20b", "/a%20b"),
        ("mjpeg+https://[::1]:444/v", "mjpeg+https://[::1]:444/v", "/v"),
        ("RTSP://u:p@camera:554/s?pwd=x", "rtsp://camera/s?...", "/s?pwd=x"),
        ("http://camera/ü#part", "http://camera/%C3%BC", "/%C3%BC"),
        ("http://[fe80::1%25eth0]:81/x", "http://[fe80::1%eth0]:81/x", "/x"),
        ("http://[fe80::1%eth0]/x", "http://[fe80::1%eth0]/x", "/x"),
    ] {
        let address = Address::parse(text).expect(text);
        assert_eq!((address.to_string().as_str(), address.target.as_str()), (shown, target));
    }
}

#[test]
fn the_login_is_decoded_and_never_shown() {
    for (text, user, password) in [
        ("http://admin:secret%231@camera/x?pwd=Tok3n", "admin", "secret#1"),
        ("http://admin:a@b:c@camera/x", "admin", "a@b:c"),
        ("http://admin@camera/x", "admin", ""),
    ] {
        let address = Address::parse(text).expect(text);
        assert_eq!(address.login, Some((user.to_owned(), password.to_owned())));
        for said in [address.to_string(), format!("{address:?}"), masked(text), address.uri()] {
            assert!(!said.contains("admin") && !said.contains("secret"), "{said}");
        }
        assert!(!masked(text).contains("Tok3n"));
        let line = format!("7 | source = \"{text}\n  | ^");
        assert!(!veiled(&line).contains(password) || password.is_empty(), "{}", veiled(&line));
        assert!(!veiled(&line).contains("Tok3n") && veiled(&line).ends_with("\n  | ^"));
    }
}

#[test]
fn what_is_no_address_says_what_to_write_and_quotes_no_password() {
    for (text, expected) in [
        ("http://admin:secret#1@camera/x", AddressError::Fragment),
        ("http://admin:secret/1@camera/x", AddressError::Port),
        ("http://::1:80/x", AddressError::Brackets),
        ("http:///x", AddressError::NoHost),
        ("http://", AddressError::NoHost),
        ("http://camera:0/", AddressError::Port),
        ("http://a b/x", AddressError::Host("a b".into())),
        ("http://u:p%zz@camera/", AddressError::Percent),
        ("ftp://camera/x", AddressError::Scheme("ftp://".into())),
        ("http://camera/\r\nx", AddressError::Control),
    ] {
        let error = Address::parse(text).expect_err(text);
        assert_eq!(error, expected, "{text}");
        assert!(!error.to_string().contains("secret"), "{error}");
    }
}

#[test]
fn redirects_keep_the_login_at_home() {
    let base = Address::parse("http://u:p@camera/a/b?c").expect("right");
    for (location, target, shares) in [
        ("/x", "/x", true),
        ("x?y", "/a/x?y", true),
        ("../x", "/x", true),
        ("./x/../y/.?z=..", "/a/y/?z=..", true),
        ("/../../x", "/x", true),
        ("?y", "/a/b?y", true),
        ("https://camera/x", "/x", true),
        ("https://camera:8443/x", "/x", false),
        ("http://camera:81/x", "/x", false),
        ("//other/x", "/x", false),
    ] {
        let there = base.redirected(location).expect(location);
        assert_eq!((there.target.as_str(), base.shares_login_with(&there)), (target, shares));
    }
    assert!(matches!(base.redirected("file:///etc/passwd"), Err(AddressError::Scheme(_))));
    let secure = Address::parse("https://camera/").expect("right");
    let there = secure.redirected("http://camera:443/").expect("right");
    assert!(!secure.shares_login_with(&there));
}

#[test]
fn a_password_in_a_path_is_not_shown() {
    for (text, expected) in [
        ("http://camera/s;pass=s3cret/x?a=b", "http://camera/s;pass=...?..."),
        (
            "rtsp://cam/user=admin_password=s3cret_stream=0.sdp",
            "rtsp://cam/user=admin_password=...",
        ),
    ] {
        let address = Address::parse(text).expect("right");
        assert_eq!(address.to_string(), expected);
        assert!(address.uri().contains("s3cret"), "the camera gets it");
    }
}
