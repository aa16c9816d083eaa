"""All pages and routes of the studio."""

from __future__ import annotations

from nicegui import app, ui
from starlette.requests import Request
from starlette.responses import RedirectResponse

from infrablend.studio.pages import compare, layout, losses, results, review, run_routes, tune
from infrablend.studio.session import Session


def add_pages(session: Session) -> None:
    """Register the pages and routes for what is open."""
    layout.share_style()

    @app.get("/")
    def first_page() -> RedirectResponse:
        return RedirectResponse(next(iter(layout.pages_of(session))))

    run = session.run
    if run is not None:
        run_routes.add_routes(run)

        @ui.page("/review")
        def review_page(request: Request) -> None:
            with layout.page_frame(session, request, "/review", "Review"):
                review.build(run, dict(request.query_params))

        @ui.page("/losses")
        def losses_page(request: Request) -> None:
            with layout.page_frame(session, request, "/losses", "Lost labels"):
                losses.build(run)

        further = session.request.results
        results.add_routes(run.layout.root, further)

        @ui.page("/results")
        def results_page(request: Request) -> None:
            with layout.page_frame(session, request, "/results", "Results"):
                data = run.record.get("data")
                results.build(run.layout.root, str(data["root"]) if isinstance(data, dict) else "DATA", further)

    tuning = session.tuning
    if tuning is not None:
        pictures = tune.add_routes()

        @ui.page("/tune")
        def tune_page(request: Request) -> None:
            with layout.page_frame(session, request, "/tune", "Tune"):
                tune.TunePage(tuning, pictures).build()

    comparison = session.comparison
    if comparison is not None:
        compare.add_routes(comparison)

        @ui.page("/compare")
        def compare_page(request: Request) -> None:
            with layout.page_frame(session, request, "/compare", "Compare"):
                compare.ComparePage(comparison).build()
