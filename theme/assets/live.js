// A page of megabytes is loaded when somebody asks for it, not before.
for (const place of document.querySelectorAll(".live")) {
  const link = place.querySelector("a");
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = place.dataset.start;
  button.addEventListener("click", () => {
    const frame = document.createElement("iframe");
    frame.src = `${link.href}#${new URLSearchParams({ q: place.dataset.ask })}`;
    frame.title = place.dataset.title;
    frame.allow = "fullscreen";
    place.querySelector(".poster").replaceWith(frame);
    frame.focus();
  });
  place.querySelector(".poster").append(button);
}
