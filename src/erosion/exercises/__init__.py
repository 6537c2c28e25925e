"""Exercises for a course: a notebook of tasks about a case, and the key that checks a student's numbers."""

from erosion.exercises.answer_key import (
    COURSES as COURSES,
    AnswerKey as AnswerKey,
    Score as Score,
    Verdict as Verdict,
)
