"""Options of the good calls, and values that no one should give, by where they stand.

No name here leads out of a case's own folder, for which ``@@`` stands.
"""

FIT = "--renderer analytic --resolution 16 --iterations 1"  # of hierarchical, a round
DIRECT = "--method direct --renderer analytic --resolution 16 --iterations 2"
RELIT = "--preset sphere --size 8 --samples 1"

# Tokens of JSON, and some that JSON has not.
TOKENS = ("null", "true", "0", "-1", "1", "0.5", "1e308", "-1e308", "1e400", "NaN", "Infinity", "-Infinity",
    "1e-320", "9" * 30,
    "9" * 400, "9" * 5000, '""', '"x"', r'"\ud800"', r'"a\u0000b"', r'"\u001b[31m"', '"../../outside"',
    '"../../outside/secret.txt"', '"@@/outside"', '"@@/outside/secret.txt"', '"/dev/zero"',
    '"' + "n" * 300 + '"', "[]", "{}",
    "[[]]", "[null]", "[1]", "[1, 2, 3]", "[[1, 2, 3]]", "[[NaN, 0, 1]]", '{"": {}}', '{"a": 1, "a": 2}',
    '{"x": "y"}', "[1,", '"', "\u00ff")
# Content that is no JSON, or not that of any of our files.
TEXTS = ("", "[]", "null", "{", "\udcff", "1", '""', "\ufeff{}")
# Names in a list of files; most lead outside, from a folder that lies two below that of the case.
NAMES = ("../../outside/secret.txt", "../../outside/folder", "../../outside/folder/keep.txt",
    "@@/outside/secret.txt", "@@/outside/folder", "maps/../../../outside/secret.txt", "to/secret.txt", "to",
    "..", ".", "", "a\0b", "n" * 300, "\ud800", "fit.json", "maps", "maps/diffuse.exr", "diffuse.exr",
    "diffuse.png")
# Values of options.
WORDS = ("", " ", "nan", "inf", "-inf", "1e300", "-1e300", "1e400", "-1", "0", "1", "0.5", "1e-320", "9" * 20,
    "9" * 400, "9" * 5000,
    "0x10", "1_000", "1e3", "2147483648", "-2147483649", "4294967296", "65536", "100000", "1,2", "0,0",
    "0,1,77", ",", "1,,2",
    "None", "True", "False", "none", "all", "auto", "=", "a=b", "--", "-", "-x", "\x1b[31m", "\x07", "a\nb",
    "\udcff", "\udcff.png", "x.json", "sub/x.json", "é", "💥", "\u202e", "n" * 300, "n" * 5000, "%s%n", "{}",
    "{0.__class__}", "$(id)",
    ";", "[red]", "[/]", "/dev/null", "/dev/zero", "/dev/full", "builtin:inlay", "builtin:", "s3://",
    "file://x",
    "normal=flat", "diffuse=0.5", "1x1", "640x", "error<0.1", "error<", 'tag:"', "llvm_ad_rgb", "srgb")
# Lines of text files: numbers of a calibration, captures of a list.
LINES = (
    "", "nan nan nan", "1e400, 0, 1", "1", "a, b, c", "0 0 0", "-1 -1 -1", "1,2,3,4", "\udcff", "9" * 400,
    "1e308 1e308 1e308",
    "0x10 1 2", "1_0 2 3", "\u0661 \u0662 \u0663", "\0", "1 2 3 " * 1000, "n" * 5000, "'", '"', "*", "**/*",
    "[", "~", "-",
    "list.txt", "../../outside", "@@/outside/folder", "s3://bucket/x", "file:///dev/zero", "../nothing",
    "\x1b]0;x\x07", *(f"../capture {own}" for own in (
        "--views 77", "--resolution nan", "--tag", "-o x", "--help", "--iterations 1e9", "--budget -1",
        "--sheet inf", "\udcff", "--fix normal=../../outside/secret.txt")),
    "../capture/capture.json", "../capture/target/00.png")
# Sides of pictures, in pixels.
SIZES = ((0, 0), (1, 1), (7, 7), (16, 17), (65535, 65535), (2**31 - 1, 2**31 - 1), (15000, 15000),
         (40000, 40000), (1, 10**6), (10**6, 1), (2**32 - 1, 1), (12000, 12000))
# Lines of MaterialX.
XML = ("", "</input>", '<!DOCTYPE a [<!ENTITY b "c">]>', '<dot name="base_color_image"/>',
       '<input name="file" type="filename" value="../../../outside/secret.txt" />',
       '<input name="in" nodename="normal_map" />', '<input name="base" value="nan" />',
       '<input name="specular_IOR" type="float" value="-1" />',
       '<input name="base_color" type="color3" value="9, x" colorspace="acescg" />')
