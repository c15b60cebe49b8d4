# SPDX-License-Identifier: Apache-2.0
"""The services of the manipulation controller."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool, Trigger

from tactile_hand_ros import names
from tactile_hand_ros.control.controller import Controller
from tactile_hand_ros.errors import GraspError
from tactile_hand_ros.nodes.accepted import Accepted
from tactile_hand_ros.ros.node import TactileNode


class ControllerServices:
    """Passes on what a user asks of the controller, and answers with what became of it."""

    def __init__(
        self,
        node: TactileNode[Any],
        controller: Controller,
        accepted: Accepted,
        on_reset: Callable[[], None],
    ) -> None:
        """Create the services.

        Args:
            node: The node.
            controller: What the user means.
            accepted: Publishes each call that changes the controller.
            on_reset: Forgets grasp, targets and integral.
        """
        self._controller = controller
        self._accepted, self._reset = accepted, on_reset
        node.create_service(Trigger, names.RESET, self._on_reset)
        node.create_service(SetBool, names.ENABLE, self._on_enable)
        node.create_service(SetBool, names.GRASP, self._on_grasp)

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._reset()
        self._accepted.request("reset")
        response.success, response.message = True, "grasp, targets and integral are forgotten"
        return response

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._controller.enabled = request.data
        self._accepted.request("enable", request.data)
        response.success, response.message = True, "enabled" if request.data else "damping only"
        return response

    def _on_grasp(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                self._controller.grasp()
            else:
                self._controller.release()
        except GraspError as error:
            response.success, response.message = False, str(error)
            return response
        self._accepted.request("grasp", request.data)
        if request.data and not self._controller.is_open:
            response.success, response.message = True, "the hand is not open, nothing to close"
        else:
            response.success, response.message = True, "closing" if request.data else "opening"
        return response
