"""An RTSP camera that shows colour bars, by GStreamer's server, for `tests/gstreamer.rs`.

    /usr/bin/python3 tests/gstreamer_camera.py h264|h265|jpeg [--port N] [--size 320x240]
        [--login USER:PASSWORD [--basic]] [--certificate FILE.pem]

Debian's packages: gir1.2-gst-rtsp-server-1.0, gstreamer1.0-plugins-good and -bad, python3-gi, and
glib-networking for TLS. Prints its port, and ends with its standard input.
"""

import argparse
import sys
import threading

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtsp", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import Gio, GLib, Gst, GstRtsp, GstRtspServer  # noqa: E402

# Ten pictures a second, a key picture every second.
ENCODERS = {
    "h264": "openh264enc gop-size=10 complexity=low ! h264parse config-interval=-1 "
            "! rtph264pay name=pay0 pt=96",
    "h265": "x265enc key-int-max=10 speed-preset=ultrafast tune=zerolatency ! h265parse "
            "config-interval=-1 ! rtph265pay name=pay0 pt=96",
    "jpeg": "jpegenc quality=90 ! rtpjpegpay name=pay0 pt=26",
}


def protected(factory, login, methods, certificate):
    """Who may look, and how they say so."""
    auth = GstRtspServer.RTSPAuth()
    role = "viewer" if login else "anyone"
    token = GstRtspServer.RTSPToken()
    token.set_string("media.factory.role", role)
    if login:
        user, password = login.split(":")
        auth.set_supported_methods(methods)
        if methods == GstRtsp.RTSPAuthMethod.BASIC:
            auth.add_basic(GstRtspServer.RTSPAuth.make_basic(user, password), token)
        else:
            auth.add_digest(user, password, token)
    else:
        auth.set_default_token(token)
    if certificate:
        auth.set_tls_certificate(Gio.TlsCertificate.new_from_file(certificate))
    permissions = GstRtspServer.RTSPPermissions()
    for may in ("media.factory.access", "media.factory.construct"):
        permissions.add_permission_for_role(role, may, True)
    factory.set_permissions(permissions)
    return auth


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("codec", choices=ENCODERS)
    args.add_argument("--port", default="0")
    args.add_argument("--size", default="320x240")
    args.add_argument("--login")
    args.add_argument("--basic", action="store_true")
    args.add_argument("--certificate")
    args = args.parse_args()
    Gst.init(None)
    width, height = args.size.split("x")
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(args.port)
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_shared(True)
    factory.set_launch(
        f"( videotestsrc is-live=true pattern=smpte75 ! video/x-raw,format=I420,width={width},"
        f"height={height},framerate=10/1 ! {ENCODERS[args.codec]} )")
    if args.login or args.certificate:
        method = GstRtsp.RTSPAuthMethod
        methods = method.BASIC if args.basic else method.DIGEST
        server.set_auth(protected(factory, args.login, methods, args.certificate))
    server.get_mount_points().add_factory("/live", factory)
    if not server.attach(None):
        sys.exit("the port is taken")
    print(server.get_bound_port(), flush=True)
    loop = GLib.MainLoop()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.quit()), daemon=True).start()
    loop.run()


if __name__ == "__main__":
    main()
