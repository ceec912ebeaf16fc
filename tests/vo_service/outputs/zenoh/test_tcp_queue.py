"""Count of unread TCP bytes."""

import socket

from vo_service.outputs.zenoh.output import queued_bytes


def test_sent_bytes_count_until_they_are_read() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as reader,
        server.accept()[0] as sender,
    ):
        pair = (sender.getsockname()[1], sender.getpeername()[1])
        sender.sendall(bytes(1000))
        assert queued_bytes([pair]) == 1000
        assert queued_bytes([(1, 2)]) == 0
        reader.recv(1000, socket.MSG_WAITALL)
        assert queued_bytes([pair]) == 0
