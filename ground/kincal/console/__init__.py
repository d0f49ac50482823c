"""The operator's console: `kincal serve`.

picture: everything known about flight at one moment, and what changed since. words: messages as plain values
with units. geometry: the arm as points. sources: live link or recording. guard: who may ask. desk: commands
and decisions. shelf: tables. bench, job: the model workbench. spaces, description, spacework: search spaces.
clearances: of corrections. work:
long work in a process of its own. app: the web server that puts these together; the browser's part is in
`static`, served as it is."""
