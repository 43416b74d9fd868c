"""A browser that is none."""

import http.client
import json
from urllib.parse import urlsplit


class Client:
    """Asks the page's program as a browser would."""

    def __init__(self, url: str):
        self.url = url
        self.address, self.path = urlsplit(url).netloc, urlsplit(url).path

    def ask(self, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes, dict]:
        connection = http.client.HTTPConnection(self.address, timeout=20)
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body, names)
        answer = connection.getresponse()
        found = answer.status, answer.read(), dict(answer.getheaders())
        connection.close()
        return found

    def get(self, name: str) -> dict:
        status, content, _ = self.ask("GET", self.path + name)
        assert status == 200, content
        return json.loads(content)

    def post(self, name: str, body: object) -> tuple[int, dict]:
        data = json.dumps(body).encode()
        status, content, _ = self.ask("POST", self.path + name, data, Content_Type="application/json")
        return status, json.loads(content)

    def set(self, camera: int, frame: int, point: int, place: list[float] | None) -> dict:
        status, found = self.post("set", {"camera": camera, "frame": frame, "point": point, "place": place})
        assert status == 200, found
        return found
