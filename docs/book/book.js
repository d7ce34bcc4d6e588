// Says how to make the body to dress where the book was built without it.
for (const frame of document.querySelectorAll("iframe.dress")) {
  const missing = () => {
    const text = "The body to dress is missing from this copy of the book. It is made after `mdbook build docs/book` by";
    const command = Object.assign(document.createElement("code"), {
      textContent: "cape view --export target/book/dress",
    });
    const note = document.createElement("p");
    note.append(text.replaceAll("`", ""), " ", command);
    frame.replaceWith(note);
  };
  // Files that are opened as such cannot be asked for.
  if (location.protocol.startsWith("http")) {
    fetch(frame.src, { method: "HEAD" }).then(answer => answer.ok || missing(), missing);
  }
}
